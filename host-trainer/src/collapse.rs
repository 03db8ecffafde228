//! The heart of `fit`: the most components of which none has collapsed on a clip.
//!
//! In:  draws of one interval, from `fit`.
//! Out: [`Mixture`] and [`FitReport`], to `fit`.
//!
//! Why here: a component that sits on one clip only repeats that clip.
//!
//! Source: Cervantes et al., ECCV 2022, section 3: a component has collapsed when a sample lies
//! within 0.1 of the mean norm of the samples from its mean. Differences:
//! * The samples are the draws that the mixture is fitted to, as in \[published code\]. \[paper\]
//!   says training representations; with those every component that stands for one clip would have
//!   collapsed, however wide it is.
//! * \[paper\] tries 100 times for every number of components, \[published code\] 10 times, then
//!   one component less: 150 fits where codes are narrow. Whether components collapse depends on
//!   σ/|μ| of the codes, hardly on luck (`notes/reference.md` A7), so here \[ours\] a number of
//!   components gets one attempt of `restarts` starts, of which the likeliest without a collapsed
//!   component is kept. If there is none, half the collapsed components go: two of them merged
//!   stand for no single clip.
//! * After `attempts_max` attempts, or at one component, a single Gaussian is taken wherever it
//!   lies \[published code\], and with a diagonal covariance if its full one cannot be factored
//!   \[ours\]. So there are at most `attempts_max · restarts + 2` fits, and always a mixture.
//! * The variance floor scales with the draws \[ours\]. \[published code\] fits f32 draws with a
//!   floor of 1e-6 whatever their scale; the covariance of a clip alone then fails to factor in one
//!   of ten starts.

use rand_chacha::ChaCha8Rng;

use crate::expectation_maximization::{Fit, Shape, fit_mixture};
use crate::k_means::{Points, square_distance};
use crate::mixture::{Covariance, Mixture, MixtureConfig};
use crate::mixture_set::{Fallback, FitReport};

/// Fits with ever fewer components until none has collapsed; see the head of this file.
///
/// `stream` gives a random stream to every (attempt, start). `None` when the points are beyond f64.
pub fn fit_sound_mixture(
    points: &Points,
    clip_count: usize,
    config: &MixtureConfig,
    stream: impl Fn(usize, usize) -> ChaCha8Rng,
) -> Option<(Mixture, FitReport)> {
    let wanted = config.components_max.min(clip_count);
    let mut shape = Shape {
        component_count: wanted,
        covariance: config.covariance,
        variance_floor: variance_floor(points, config.regularization),
    };
    let radius = config.collapse_distance * mean_norm(points);
    let mut attempt_count = 0;
    while shape.component_count > 1 && attempt_count < config.attempts_max {
        let starts = (0..config.restarts).map(|start| stream(attempt_count, start));
        let attempt = attempt_fit(points, shape, radius, starts);
        attempt_count += 1;
        match attempt {
            Attempt::Sound(fit) => {
                let gave_up = shape.component_count < wanted;
                let fallback = gave_up.then_some(Fallback::FewerComponents);
                return Some(report_fit(fit, attempt_count, fallback));
            }
            Attempt::Collapsed(count) => shape.component_count -= count.div_ceil(2).max(1),
        }
    }
    let fallback = (wanted > 1).then_some(Fallback::SingleGaussian);
    let (fit, fallback) = fit_single_gaussian(points, shape, fallback, stream(attempt_count, 0))?;
    Some(report_fit(fit, attempt_count + 1, fallback))
}

fn fit_single_gaussian(
    points: &Points,
    mut shape: Shape,
    fallback: Option<Fallback>,
    mut rng: ChaCha8Rng,
) -> Option<(Fit, Option<Fallback>)> {
    shape.component_count = 1;
    if let Some(fit) = fit_mixture(points, shape, &mut rng) {
        return Some((fit, fallback));
    }
    shape.covariance = Covariance::Diagonal;
    fit_mixture(points, shape, &mut rng).map(|fit| (fit, Some(Fallback::DiagonalGaussian)))
}

fn report_fit(fit: Fit, attempt_count: usize, fallback: Option<Fallback>) -> (Mixture, FitReport) {
    let report = FitReport {
        attempt_count,
        fallback,
        log_likelihood_mean: fit.log_likelihood_mean(),
    };
    (fit.mixture, report)
}

enum Attempt {
    /// The likeliest fit without a collapsed component.
    Sound(Fit),
    /// The least number of collapsed components of any start.
    Collapsed(usize),
}

fn attempt_fit(
    points: &Points,
    shape: Shape,
    radius: f64,
    starts: impl Iterator<Item = ChaCha8Rng>,
) -> Attempt {
    let mut kept: Option<Fit> = None;
    let mut collapsed_min = shape.component_count;
    for mut start in starts {
        let Some(fit) = fit_mixture(points, shape, &mut start) else {
            continue;
        };
        let collapsed = collapsed_count(points, &fit.mixture, radius);
        collapsed_min = collapsed_min.min(collapsed);
        let best = kept
            .as_ref()
            .map_or(f64::NEG_INFINITY, Fit::log_likelihood_mean);
        if collapsed == 0 && fit.log_likelihood_mean() > best {
            kept = Some(fit);
        }
    }
    kept.map_or(Attempt::Collapsed(collapsed_min), Attempt::Sound)
}

/// Number of components whose mean lies within `radius` of a draw.
fn collapsed_count(points: &Points, mixture: &Mixture, radius: f64) -> usize {
    let square_radius = radius * radius;
    let is_near = |mean: &[f64]| {
        points
            .iter()
            .any(|point| square_distance(point, mean) < square_radius)
    };
    mixture
        .components
        .iter()
        .filter(|component| is_near(&component.mean))
        .count()
}

fn mean_norm(points: &Points) -> f64 {
    let norms = points.iter().map(|point| square_norm(point).sqrt());
    norms.sum::<f64>() / points.count() as f64
}

fn square_norm(point: &[f64]) -> f64 {
    point.iter().map(|value| value * value).sum()
}

/// Share of the draws' mean variance; of what rounding leaves of it when the draws coincide; never
/// 0.
fn variance_floor(points: &Points, regularization: f64) -> f64 {
    let count = points.count() as f64;
    let mut mean = vec![0.0; points.dimension_count];
    for point in points.iter() {
        for (sum, value) in mean.iter_mut().zip(point) {
            *sum += value / count;
        }
    }
    let total: f64 = points
        .iter()
        .map(|point| square_distance(point, &mean))
        .sum();
    let square_total: f64 = points.iter().map(square_norm).sum();
    let number_count = count * points.dimension_count as f64;
    regularization * (total + f64::EPSILON * square_total) / number_count + f64::MIN_POSITIVE
}
