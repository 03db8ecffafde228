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

use crate::k_means::{Points, cluster};
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
/// # Cost At most 2 · points · components · dimensions² floating-point operations a round, twice
/// half a matrix product; a point costs nothing in the second half where a component has no share
/// in it. One thread, so that the result does not depend on their number.
pub fn fit_mixture<R: Rng + ?Sized>(points: &Points, shape: Shape, rng: &mut R) -> Option<Fit> {
    let groups = cluster(points, shape.component_count, rng);
    let mut shares = shares_of_groups(&groups, shape.component_count);
    let mut gaussians = maximize(points, &shares, shape)?;
    let mut log_likelihoods: Vec<f64> = Vec::new();
    loop {
        let reached = expect(points, &gaussians, &mut shares);
        let gain = log_likelihoods
            .last()
            .map_or(f64::MAX, |last| reached - last);
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
        .map(|index| {
            groups
                .iter()
                .map(|&group| f64::from(group == index))
                .collect()
        })
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
    shares
        .iter()
        .map(|shares| Gaussian::fit(points, shares, shape))
        .collect()
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
        let members = || {
            points
                .iter()
                .zip(shares)
                .filter(|&(_, &share)| share > f64::EPSILON)
        };
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
            deviations.extend(
                point
                    .iter()
                    .zip(&mean)
                    .map(|(value, mean)| root * (value - mean)),
            );
        }
        let spread = match shape.covariance {
            Covariance::Full => Spread::Full(full_factor(&deviations, mean.len(), shape)?),
            Covariance::Diagonal => {
                Spread::Diagonal(standard_deviations(&deviations, mean.len(), shape))
            }
        };
        Some(Self {
            weight: total / points.count() as f64,
            mean,
            spread,
        })
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
            whitened.extend(
                point
                    .iter()
                    .zip(&self.mean)
                    .map(|(value, mean)| value - mean),
            );
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
        Component {
            weight: self.weight,
            mean: self.mean,
            factor,
        }
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
