//! Station 5: a Gaussian mixture, the density over the sequence codes of one action and interval.
//!
//! In:  `expectation_maximization`, or the cache `mixture_file`.
//! Out: [`Mixture`], to `mixture_set`.
//!
//! Why here: a mixture holds no seed and no generator. Every call draws on with the caller's
//! generator, so two calls never give the same code and components come in random order.
//!
//! Source: Cervantes et al., ECCV 2022, section 3. \[published code\] draws with a generator that
//! is seeded anew in every call, so all repetitions of its evaluation score one and the same set of
//! motions, sorted by component.

pub mod interval;
pub mod k_means;
pub mod expectation_maximization;
pub mod collapse;
pub mod fit;
pub mod set;
pub mod file;

use std::f64::consts::TAU;

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// How the mixture is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixtureConfig {
    /// Most components of one mixture; fewer clips make fewer components. Source: 15 in the paper.
    pub components_max: usize,
    /// Shape of the components. Source: full in the published code.
    pub covariance: Covariance,
    /// Draws from every clip's Gaussian that the mixture is fitted to. Source: 50 in the paper.
    pub draws_per_clip: usize,
    /// Least number of lengths of an interval, in frames. Source: 10 in the published code.
    pub interval_frames_min: usize,
    /// Least number of clips of an interval.
    pub interval_clips_min: usize,
    /// Most numbers of components tried, by bisection, before the best so far is taken; 5 settle
    /// any number up to 16.
    ///
    /// Source: 100 tries for each number of components in the paper, 10 in the published code.
    pub attempts_max: usize,
    /// Starts of the fit in one attempt; the likeliest is kept. Source: 1 in the published code.
    pub restarts: usize,
    /// Variance added in every dimension, as a share of the mean variance of the draws.
    pub regularization: f64,
    /// A component has collapsed when a draw is nearer to its mean than this share of the draws'
    /// mean norm; 0 allows all.
    /// Source: 0.1 in the paper.
    pub collapse_distance: f64,
}

/// Shape of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Covariance {
    /// Any ellipsoid.
    Full,
    /// An ellipsoid along the axes.
    Diagonal,
}

/// Square root of a component's covariance.
#[derive(Clone, Debug, PartialEq)]
pub enum Factor {
    /// Lower triangle of the Cholesky factor L, covariance = L·Lᵀ, row by row: row i holds i + 1
    /// numbers.
    Full(Vec<f64>),
    /// Standard deviations. // (dimension)
    Diagonal(Vec<f64>),
}

/// One Gaussian of a mixture.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Probability of this component.
    pub weight: f64,
    /// Its centre. // (dimension)
    pub mean: Vec<f64>,
    /// Its spread.
    pub factor: Factor,
}

impl Component {
    fn sample<R: Rng + ?Sized>(&self, rng: &mut R) -> Vec<f64> {
        let noise: Vec<f64> = StandardNormal.sample_iter(rng).take(self.mean.len()).collect();
        let mut code = self.mean.clone();
        match &self.factor {
            Factor::Full(lower) => {
                for (row, value) in code.iter_mut().enumerate() {
                    *value += dot(triangle_row(lower, row), &noise);
                }
            }
            Factor::Diagonal(deviations) => {
                for ((value, deviation), noise) in code.iter_mut().zip(deviations).zip(noise) {
                    *value += deviation * noise;
                }
            }
        }
        code
    }

    /// ln N(code; mean, covariance).
    fn log_density(&self, code: &[f64]) -> f64 {
        let mut whitened: Vec<f64> = Vec::with_capacity(code.len());
        let mut log_volume = 0.0;
        for (row, (value, mean)) in code.iter().zip(&self.mean).enumerate() {
            let (explained, deviation) = match &self.factor {
                Factor::Full(lower) => {
                    let weights = triangle_row(lower, row);
                    (dot(weights, &whitened), weights[row])
                }
                Factor::Diagonal(deviations) => (0.0, deviations[row]),
            };
            whitened.push((value - mean - explained) / deviation);
            log_volume += deviation.ln();
        }
        log_normal(whitened.len(), dot(&whitened, &whitened), log_volume)
    }
}

/// ln of a Gaussian: −½ (d ln 2π + y·y) − ln |L|.
pub(crate) fn log_normal(dimension_count: usize, square_norm: f64, log_volume: f64) -> f64 {
    -0.5 * (dimension_count as f64 * TAU.ln() + square_norm) - log_volume
}

fn triangle_row(lower: &[f64], row: usize) -> &[f64] {
    let start = row * (row + 1) / 2;
    &lower[start..=start + row]
}

/// Over the shorter of the two.
fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(a, b)| a * b).sum()
}

/// ln Σ exp(x), free of overflow and underflow.
pub(crate) fn log_sum_exp(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let max = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    if max == f64::NEG_INFINITY {
        return max;
    }
    max + logs.map(|log| (log - max).exp()).sum::<f64>().ln()
}

/// A density over codes.
///
/// `fit` guarantees: at least one component, weights that sum to 1, finite numbers, positive
/// deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct Mixture {
    /// Numbers per code.
    pub dimension_count: usize,
    /// The Gaussians.
    pub components: Vec<Component>,
}

impl Mixture {
    /// Draws one code; every call goes on in the caller's random stream.
    pub fn sample<R: Rng + ?Sized>(&self, rng: &mut R) -> Vec<f64> {
        let mut position: f64 = rng.random();
        let chosen = self.components.iter().position(|component| {
            position -= component.weight;
            position < 0.0
        });
        // Rounding may leave the sum of the weights a hair below the position drawn.
        let last = self.components.len() - 1;
        self.components[chosen.unwrap_or(last)].sample(rng)
    }

    /// Natural logarithm of the density at a code; finite however far the code is from every
    /// component.
    pub fn log_density(&self, code: &[f64]) -> f64 {
        let logs: Vec<f64> = self
            .components
            .iter()
            .map(|component| component.weight.ln() + component.log_density(code))
            .collect();
        log_sum_exp(logs.into_iter())
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn mixture_of(factors: [Factor; 2]) -> Mixture {
        let means = [vec![1.0, -2.0, 0.5], vec![-3.0, 4.0, 0.0]];
        let components = means.into_iter().zip(factors).zip([0.25, 0.75]);
        Mixture {
            dimension_count: 3,
            components: components
                .map(|((mean, factor), weight)| Component { weight, mean, factor })
                .collect(),
        }
    }

    fn full() -> Mixture {
        mixture_of([
            Factor::Full(vec![1.0, 0.5, 2.0, -0.3, 0.2, 0.7]),
            Factor::Full(vec![0.4, -0.1, 0.6, 0.8, 0.0, 0.3]),
        ])
    }

    fn diagonal() -> Mixture {
        mixture_of([Factor::Diagonal(vec![1.0, 2.0, 0.7]), Factor::Diagonal(vec![0.4, 0.6, 0.3])])
    }

    /// Element of the covariance L·Lᵀ.
    fn covariance(factor: &Factor, row: usize, column: usize) -> f64 {
        match factor {
            Factor::Full(lower) => dot(triangle_row(lower, row), triangle_row(lower, column)),
            Factor::Diagonal(deviations) if row == column => deviations[row] * deviations[row],
            Factor::Diagonal(_) => 0.0,
        }
    }

    #[test]
    fn log_density_far_from_every_component_is_finite() {
        for mixture in [full(), diagonal()] {
            let log_density = mixture.log_density(&[1e6, -1e6, 1e6]);
            assert!(log_density < -1e6 && log_density.is_finite());
        }
    }

    #[test]
    fn sum_of_nothing_is_minus_infinity_in_the_logarithm() {
        assert_eq!(log_sum_exp([f64::NEG_INFINITY; 2].into_iter()), f64::NEG_INFINITY);
        assert_eq!(log_sum_exp([-1e7, -1e7].into_iter()), -1e7 + 2f64.ln());
    }

    #[test]
    fn log_density_of_a_standard_normal_matches_its_formula() {
        let normal = Mixture {
            dimension_count: 2,
            components: vec![Component {
                weight: 1.0,
                mean: vec![0.0; 2],
                factor: Factor::Full(vec![1.0, 0.0, 1.0]),
            }],
        };
        let expected = -TAU.ln() - 0.5 * (9.0 + 16.0);
        assert!((normal.log_density(&[3.0, 4.0]) - expected).abs() < 1e-12);
    }

    #[test]
    fn mixture_sample_matches_mean_and_covariance() {
        const COUNT: usize = 200_000;
        for mixture in [full(), diagonal()] {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let codes: Vec<_> = (0..COUNT).map(|_| mixture.sample(&mut rng)).collect();
            let expectation = |value: &dyn Fn(&Component) -> f64| -> f64 {
                mixture.components.iter().map(|c| c.weight * value(c)).sum()
            };
            for row in 0..3 {
                let mean = codes.iter().map(|code| code[row]).sum::<f64>() / COUNT as f64;
                assert!((mean - expectation(&|c| c.mean[row])).abs() < 0.03);
                for column in 0..=row {
                    let products = codes.iter().map(|code| code[row] * code[column]);
                    let found = products.sum::<f64>() / COUNT as f64;
                    let expected = expectation(&|c| {
                        covariance(&c.factor, row, column) + c.mean[row] * c.mean[column]
                    });
                    assert!((found - expected).abs() < 0.1, "{found} is not {expected}");
                }
            }
        }
    }

    #[test]
    fn components_come_in_random_order_and_no_two_codes_are_equal() {
        let mixture = diagonal();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let codes: Vec<_> = (0..1000).map(|_| mixture.sample(&mut rng)).collect();
        let is_first: Vec<bool> = codes.iter().map(|code| code[1] < 1.0).collect();
        let changes = is_first.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!((300..450).contains(&changes), "{changes} changes of 375 expected");
        assert!(codes.windows(2).all(|pair| pair[0] != pair[1]));
    }
}
