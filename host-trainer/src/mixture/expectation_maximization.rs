//! Maximum-likelihood Gaussian mixtures by expectation maximisation.
//!
//! In:  points and a generator, from `fit`.
//! Out: [`Mixture`] and how its likelihood rose, to `fit`.
//!
//! Why here: the published crates fail on codes, whose log-densities under a foreign component
//! reach −10⁷: they sum exponentials without taking out the largest. Here everything is f64, sums
//! of exponentials are taken in the logarithm, and a variance floor that scales with the data keeps
//! every covariance invertible.
//!
//! Source: Dempster, Laird and Rubin 1977. Tolerance and cap of scikit-learn's `GaussianMixture`,
//! which \[published code\] uses; that adds 1e-6 to every variance whatever the scale of the codes.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rand::Rng;

use crate::mixture::k_means::{Points, cluster};
use crate::mixture::{Component, Covariance, Factor, Mixture, log_normal, log_sum_exp};

/// Most rounds. Source: scikit-learn.
const ROUND_COUNT_MAX: usize = 100;
/// Gain of mean log-likelihood, in nats, below which the fit has converged. Source: scikit-learn.
const GAIN_MIN: f64 = 1e-3;
/// Points whitened at a time; 256 · 128 · 8 bytes stay in the second-level cache.
const BLOCK_LEN: usize = 256;

/// What to fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Number of components; points that coincide can make them fewer.
    pub component_count: usize,
    /// Shape of the components.
    pub covariance: Covariance,
    /// Added to every variance; positive.
    pub variance_floor: f64,
}

/// A fitted mixture.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The mixture.
    pub mixture: Mixture,
    /// Mean log-density of the points before each round; the last is that of `mixture`. // (round)
    pub log_likelihoods: Vec<f64>,
}

impl Fit {
    /// Mean log-density of the points under the mixture, in nats.
    pub fn log_likelihood_mean(&self) -> f64 {
        self.log_likelihoods[self.log_likelihoods.len() - 1]
    }
}

/// Fits a mixture from one k-means++ start.
///
/// `None` when a component lost all its points or its covariance cannot be factored.
///
/// # Cost
/// Two triangular matrix products a round, together 2 · points · components · dimensions²
/// floating-point operations; in the second, a point costs nothing where a component has no share
/// in it. One thread, so that the result does not depend on their number.
pub fn fit_mixture<R: Rng + ?Sized>(points: &Points, shape: Shape, rng: &mut R) -> Option<Fit> {
    let groups = cluster(points, shape.component_count, rng);
    let mut shares = shares_of_groups(&groups, shape.component_count);
    let mut gaussians = maximize(points, &shares, shape)?;
    let mut log_likelihoods: Vec<f64> = Vec::new();
    loop {
        let reached = expect(points, &gaussians, &mut shares);
        let gain = log_likelihoods.last().map_or(f64::MAX, |last| reached - last);
        log_likelihoods.push(reached);
        if !reached.is_finite() {
            return None;
        }
        if gain < GAIN_MIN || log_likelihoods.len() == ROUND_COUNT_MAX {
            break;
        }
        gaussians = maximize(points, &shares, shape)?;
    }
    let components = gaussians.into_iter().map(Gaussian::into_component);
    Some(Fit {
        mixture: Mixture {
            dimension_count: points.dimension_count,
            components: components.collect(),
        },
        log_likelihoods,
    })
}

/// Whole shares for every group that has points. // (component, point)
fn shares_of_groups(groups: &[usize], group_count: usize) -> Vec<Vec<f64>> {
    (0..group_count)
        .filter(|index| groups.contains(index))
        .map(|index| groups.iter().map(|&group| f64::from(group == index)).collect())
        .collect()
}

/// Replaces `shares` by every component's share in every point; returns the mean log-density of the
/// points.
fn expect(points: &Points, gaussians: &[Gaussian], shares: &mut [Vec<f64>]) -> f64 {
    for (gaussian, logs) in gaussians.iter().zip(&mut *shares) {
        gaussian.log_densities(points, logs);
    }
    let mut total = 0.0;
    for point in 0..points.count() {
        let log_density = log_sum_exp(shares.iter().map(|logs| logs[point]));
        for logs in &mut *shares {
            logs[point] = (logs[point] - log_density).exp();
        }
        total += log_density;
    }
    total / points.count() as f64
}

/// The likeliest Gaussians for given shares, with the variance floor added.
fn maximize(points: &Points, shares: &[Vec<f64>], shape: Shape) -> Option<Vec<Gaussian>> {
    shares.iter().map(|shares| Gaussian::fit(points, shares, shape)).collect()
}

/// A component in the form that the rounds work on.
struct Gaussian {
    weight: f64,
    mean: Vec<f64>,
    spread: Spread,
}

enum Spread {
    /// Lower Cholesky factor of the covariance. // (dimension, dimension)
    Full(Mat<f64>),
    /// Standard deviations. // (dimension)
    Diagonal(Vec<f64>),
}

impl Gaussian {
    fn fit(points: &Points, shares: &[f64], shape: Shape) -> Option<Self> {
        // A share that rounding would swallow is none: most components have none in most points.
        let members = || points.iter().zip(shares).filter(|&(_, &share)| share > f64::EPSILON);
        let total: f64 = members().map(|(_, share)| share).sum();
        if total <= f64::EPSILON {
            return None;
        }
        let mut mean = vec![0.0; points.dimension_count];
        for (point, share) in members() {
            for (sum, value) in mean.iter_mut().zip(point) {
                *sum += share / total * value;
            }
        }
        // Every deviation carries the root of its share, so that their products carry the share.
        let mut deviations = Vec::new();
        for (point, share) in members() {
            let root = (share / total).sqrt();
            deviations.extend(point.iter().zip(&mean).map(|(value, mean)| root * (value - mean)));
        }
        let spread = match shape.covariance {
            Covariance::Full => Spread::Full(full_factor(&deviations, mean.len(), shape)?),
            Covariance::Diagonal => {
                Spread::Diagonal(standard_deviations(&deviations, mean.len(), shape))
            }
        };
        Some(Self { weight: total / points.count() as f64, mean, spread })
    }

    /// Writes ln(weight · density) of every point.
    fn log_densities(&self, points: &Points, logs: &mut [f64]) {
        let dimension_count = self.mean.len();
        let log_volume: f64 = match &self.spread {
            Spread::Full(factor) => (0..dimension_count).map(|i| factor[(i, i)].ln()).sum(),
            Spread::Diagonal(deviations) => deviations.iter().map(|deviation| deviation.ln()).sum(),
        };
        let mut whitened = Vec::with_capacity(BLOCK_LEN * dimension_count);
        let blocks = points.values.chunks(BLOCK_LEN * dimension_count);
        for (block, logs) in blocks.zip(logs.chunks_mut(BLOCK_LEN)) {
            self.whiten(block, &mut whitened);
            for (log, whitened) in logs.iter_mut().zip(whitened.chunks_exact(dimension_count)) {
                let square_norm = whitened.iter().map(|value| value * value).sum();
                *log = self.weight.ln() + log_normal(dimension_count, square_norm, log_volume);
            }
        }
    }

    /// Writes L⁻¹ (point − mean) for every point of a block. // (point, dimension)
    fn whiten(&self, block: &[f64], whitened: &mut Vec<f64>) {
        let dimension_count = self.mean.len();
        whitened.clear();
        for point in block.chunks_exact(dimension_count) {
            whitened.extend(point.iter().zip(&self.mean).map(|(value, mean)| value - mean));
        }
        match &self.spread {
            Spread::Full(factor) => {
                let count = whitened.len() / dimension_count;
                let columns = MatMut::from_column_major_slice_mut(whitened, dimension_count, count);
                solve_lower_triangular_in_place(factor.as_ref(), columns, Par::Seq);
            }
            Spread::Diagonal(deviations) => {
                for point in whitened.chunks_exact_mut(dimension_count) {
                    for (value, deviation) in point.iter_mut().zip(deviations) {
                        *value /= deviation;
                    }
                }
            }
        }
    }

    fn into_component(self) -> Component {
        let factor = match self.spread {
            Spread::Full(factor) => {
                let row = |row| (0..=row).map(move |column| (row, column));
                let triangle = (0..self.mean.len()).flat_map(row);
                Factor::Full(triangle.map(|place| factor[place]).collect())
            }
            Spread::Diagonal(deviations) => Factor::Diagonal(deviations),
        };
        Component { weight: self.weight, mean: self.mean, factor }
    }
}

/// Cholesky factor of the deviations' covariance; `None` when rounding leaves it indefinite.
fn full_factor(deviations: &[f64], dimension_count: usize, shape: Shape) -> Option<Mat<f64>> {
    let count = deviations.len() / dimension_count;
    let deviations = MatRef::from_column_major_slice(deviations, dimension_count, count);
    let mut factor = Mat::zeros(dimension_count, dimension_count);
    triangular::matmul(
        &mut factor,
        BlockStructure::TriangularLower,
        Accum::Replace,
        deviations,
        BlockStructure::Rectangular,
        deviations.transpose(),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    for i in 0..dimension_count {
        factor[(i, i)] += shape.variance_floor;
    }
    let scratch = cholesky_in_place_scratch::<f64>(dimension_count, Par::Seq, Default::default());
    cholesky_in_place(
        factor.as_mut(),
        Default::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        Default::default(),
    )
    .ok()?;
    let is_sound = (0..dimension_count).all(|i| factor[(i, i)].is_finite() && factor[(i, i)] > 0.0);
    is_sound.then_some(factor)
}

fn standard_deviations(deviations: &[f64], dimension_count: usize, shape: Shape) -> Vec<f64> {
    let mut variances = vec![shape.variance_floor; dimension_count];
    for point in deviations.chunks_exact(dimension_count) {
        for (variance, deviation) in variances.iter_mut().zip(point) {
            *variance += deviation * deviation;
        }
    }
    variances.into_iter().map(f64::sqrt).collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Below what the tests tell apart, above what rounding disturbs.
    const FLOOR: f64 = 1e-9;

    fn shape(component_count: usize, covariance: Covariance) -> Shape {
        Shape { component_count, covariance, variance_floor: FLOOR }
    }

    fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    fn full(weight: f64, mean: [f64; 2], lower: [f64; 3]) -> Component {
        Component { weight, mean: mean.to_vec(), factor: Factor::Full(lower.to_vec()) }
    }

    /// Two tilted ellipses that overlap a little.
    fn known_mixture() -> Mixture {
        Mixture {
            dimension_count: 2,
            components: vec![
                full(0.3, [-2.0, 1.0], [1.0, 0.6, 0.5]),
                full(0.7, [3.0, -1.0], [0.5, -0.8, 1.2]),
            ],
        }
    }

    fn draw(mixture: &Mixture, count: usize, seed: u64) -> Vec<f64> {
        let mut rng = rng(seed);
        (0..count).flat_map(|_| mixture.sample(&mut rng)).collect()
    }

    fn factor(component: &Component) -> &[f64] {
        match &component.factor {
            Factor::Full(numbers) | Factor::Diagonal(numbers) => numbers,
        }
    }

    fn assert_near(actual: &[f64], expected: &[f64], tolerance: f64) {
        assert_eq!(actual.len(), expected.len());
        for (actual, expected) in actual.iter().zip(expected) {
            assert!((actual - expected).abs() < tolerance, "{actual} is not {expected}");
        }
    }

    #[test]
    fn one_point_makes_a_gaussian_as_narrow_as_the_floor() {
        let points = Points { dimension_count: 2, values: &[4.0, -5.0] };
        let fit = fit_mixture(&points, shape(3, Covariance::Full), &mut rng(1)).unwrap();
        assert_eq!(fit.mixture.components.len(), 1);
        assert_eq!(fit.mixture.components[0].mean, [4.0, -5.0]);
        let deviation = FLOOR.sqrt();
        assert_near(factor(&fit.mixture.components[0]), &[deviation, 0.0, deviation], 1e-15);
    }

    #[test]
    fn fewer_points_than_dimensions_still_make_a_full_covariance() {
        let mut rng = rng(2);
        let values: Vec<f64> = (0..5 * 64).map(|_| rng.random()).collect();
        let points = Points { dimension_count: 64, values: &values };
        let fit = fit_mixture(&points, shape(2, Covariance::Full), &mut rng).unwrap();
        assert!(fit.log_likelihood_mean().is_finite());
        let numbers = fit.mixture.components.iter().flat_map(factor);
        assert!(numbers.into_iter().all(|number| number.is_finite()));
    }

    #[test]
    fn points_whose_foreign_log_density_is_below_minus_a_million_stay_finite() {
        let mut rng = rng(3);
        let values: Vec<f64> = (0..100)
            .flat_map(|i| [1e5 * f64::from(i % 2) + rng.random::<f64>(), rng.random()])
            .collect();
        let points = Points { dimension_count: 2, values: &values };
        for covariance in [Covariance::Full, Covariance::Diagonal] {
            let fit = fit_mixture(&points, shape(2, covariance), &mut rng).unwrap();
            let near_first = &fit.mixture.components[0];
            let far_mean = &fit.mixture.components[1].mean;
            let alone = Mixture { dimension_count: 2, components: vec![near_first.clone()] };
            assert!(alone.log_density(far_mean) < -1e6);
            assert!(alone.log_density(far_mean).is_finite());
            assert!(fit.log_likelihoods.iter().all(|value| value.is_finite()));
            assert_near(&[near_first.weight], &[0.5], 1e-12);
        }
    }

    #[test]
    fn likelihood_never_falls() {
        let values = draw(&known_mixture(), 600, 4);
        let points = Points { dimension_count: 2, values: &values };
        for covariance in [Covariance::Full, Covariance::Diagonal] {
            for seed in 0..8 {
                let fit = fit_mixture(&points, shape(4, covariance), &mut rng(seed)).unwrap();
                assert!(fit.log_likelihoods.len() > 2);
                assert!(fit.log_likelihoods.is_sorted(), "{:?}", fit.log_likelihoods);
            }
        }
    }

    #[test]
    fn likelihood_is_the_mean_log_density_of_the_points() {
        let values = draw(&known_mixture(), 600, 5);
        let points = Points { dimension_count: 2, values: &values };
        for covariance in [Covariance::Full, Covariance::Diagonal] {
            let fit = fit_mixture(&points, shape(3, covariance), &mut rng(5)).unwrap();
            let total: f64 = points.iter().map(|point| fit.mixture.log_density(point)).sum();
            assert_near(&[fit.log_likelihood_mean()], &[total / 600.0], 1e-10);
        }
    }

    #[test]
    fn known_mixture_is_recovered_from_its_draws() {
        let known = known_mixture();
        let values = draw(&known, 20_000, 6);
        let points = Points { dimension_count: 2, values: &values };
        let mut fit = fit_mixture(&points, shape(2, Covariance::Full), &mut rng(6)).unwrap();
        fit.mixture.components.sort_by(|a, b| a.weight.total_cmp(&b.weight));
        for (found, known) in fit.mixture.components.iter().zip(&known.components) {
            assert_near(&[found.weight], &[known.weight], 0.01);
            assert_near(&found.mean, &known.mean, 0.05);
            assert_near(factor(found), factor(known), 0.05);
        }
    }

    #[test]
    fn diagonal_fit_finds_the_deviations_and_full_fit_is_likelier_on_tilted_data() {
        let values = draw(&known_mixture(), 20_000, 7);
        let points = Points { dimension_count: 2, values: &values };
        let full = fit_mixture(&points, shape(2, Covariance::Full), &mut rng(7)).unwrap();
        let mut diagonal =
            fit_mixture(&points, shape(2, Covariance::Diagonal), &mut rng(7)).unwrap();
        assert!(full.log_likelihood_mean() > diagonal.log_likelihood_mean() + 0.1);
        diagonal.mixture.components.sort_by(|a, b| a.weight.total_cmp(&b.weight));
        // Standard deviations along the axes: the norms of the factors' rows.
        let expected = [[1.0, 0.36f64 + 0.25], [0.5, 0.64f64 + 1.44]];
        for (found, expected) in diagonal.mixture.components.iter().zip(expected) {
            assert_near(factor(found), &[expected[0], expected[1].sqrt()], 0.1);
        }
    }

    #[test]
    fn points_scaled_by_a_power_of_two_make_the_same_mixture_scaled() {
        let values = draw(&known_mixture(), 500, 8);
        let scaled: Vec<f64> = values.iter().map(|value| value * 1024.0).collect();
        let points = Points { dimension_count: 2, values: &values };
        let scaled = Points { dimension_count: 2, values: &scaled };
        let small = shape(3, Covariance::Full);
        let large = Shape { variance_floor: FLOOR * 1024.0 * 1024.0, ..small };
        let small = fit_mixture(&points, small, &mut rng(8)).unwrap();
        let large = fit_mixture(&scaled, large, &mut rng(8)).unwrap();
        for (small, large) in small.mixture.components.iter().zip(&large.mixture.components) {
            assert_near(&[large.weight], &[small.weight], 1e-9);
            let shrunk: Vec<f64> = factor(large).iter().map(|value| value / 1024.0).collect();
            assert_near(&shrunk, factor(small), 1e-9);
        }
    }
}
