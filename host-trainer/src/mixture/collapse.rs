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
//!   components gets one attempt, and bisection finds the greatest that is sound: 5 attempts from 15
//!   components, never more than `attempts_max`.
//! * An attempt is `restarts` starts, of which the likeliest without a collapsed component is kept
//!   \[ours\]; \[published code\] has one start.
//! * Where no attempt is sound, a single Gaussian is taken wherever it lies \[published code\], with
//!   a diagonal covariance if its full one cannot be factored \[ours\]. So there are at most
//!   `attempts_max · restarts + 2` fits, and always a mixture.

use rand_chacha::ChaCha8Rng;

use crate::mixture::expectation_maximization::{Fit, Shape, fit_mixture};
use crate::mixture::k_means::{Points, square_distance};
use crate::mixture::set::{Fallback, FitReport};
use crate::mixture::{Covariance, Mixture, MixtureConfig};

/// Fits the most components of which none has collapsed; see the head of this file.
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
    // One component counts as sound, so that there is always something to fall back on.
    let (mut sound_max, mut collapsed_min) = (1, wanted + 1);
    let mut best = None;
    let mut attempt_count = 0;
    while collapsed_min - sound_max > 1 && attempt_count < config.attempts_max {
        let starts = (0..config.restarts).map(|start| stream(attempt_count, start));
        match likeliest_sound_fit(points, shape, radius, starts) {
            Some(fit) => (best, sound_max) = (Some(fit), shape.component_count),
            None => collapsed_min = shape.component_count,
        }
        attempt_count += 1;
        shape.component_count = sound_max.midpoint(collapsed_min);
    }
    if let Some(fit) = best {
        let fallback = (sound_max < wanted).then_some(Fallback::FewerComponents);
        return Some(report_fit(fit, attempt_count, fallback));
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
    let report =
        FitReport { attempt_count, fallback, log_likelihood_mean: fit.log_likelihood_mean() };
    (fit.mixture, report)
}

/// `None` when a component has collapsed from every start.
fn likeliest_sound_fit(
    points: &Points,
    shape: Shape,
    radius: f64,
    starts: impl Iterator<Item = ChaCha8Rng>,
) -> Option<Fit> {
    starts
        .filter_map(|mut start| fit_mixture(points, shape, &mut start))
        .filter(|fit| !has_collapsed(points, &fit.mixture, radius))
        .max_by(|a, b| a.log_likelihood_mean().total_cmp(&b.log_likelihood_mean()))
}

/// Whether the mean of a component lies within `radius` of a point.
fn has_collapsed(points: &Points, mixture: &Mixture, radius: f64) -> bool {
    let square_radius = radius * radius;
    mixture.components.iter().any(|component| {
        points.iter().any(|point| square_distance(point, &component.mean) < square_radius)
    })
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
    let total: f64 = points.iter().map(|point| square_distance(point, &mean)).sum();
    let square_total: f64 = points.iter().map(square_norm).sum();
    let number_count = count * points.dimension_count as f64;
    regularization * (total + f64::EPSILON * square_total) / number_count + f64::MIN_POSITIVE
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const DIMENSION_COUNT: usize = 8;

    fn config() -> MixtureConfig {
        MixtureConfig {
            components_max: 15,
            covariance: Covariance::Full,
            draws_per_clip: 30,
            interval_frames_min: 10,
            interval_clips_min: 5,
            attempts_max: 10,
            restarts: 2,
            regularization: 1e-3,
            collapse_distance: 0.1,
        }
    }

    /// Draws around the given number of clips, whose own means are standard normal.
    fn draws(clip_count: usize, deviation: f64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut values = Vec::new();
        for _ in 0..clip_count {
            let mean: [f64; DIMENSION_COUNT] =
                std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            for _ in 0..config().draws_per_clip {
                values.extend(
                    mean.map(|mean| mean + deviation * rng.sample::<f64, _>(StandardNormal)),
                );
            }
        }
        values
    }

    fn fit_draws(
        values: &[f64],
        clip_count: usize,
        config: &MixtureConfig,
    ) -> (Mixture, FitReport) {
        let points = Points { dimension_count: DIMENSION_COUNT, values };
        let stream = |attempt, start| ChaCha8Rng::seed_from_u64((attempt * 100 + start) as u64);
        let fit = fit_sound_mixture(&points, clip_count, config, stream).unwrap();
        let numbers = |component: &crate::mixture::Component| component.mean.iter().sum::<f64>();
        assert!(fit.0.components.iter().map(numbers).all(f64::is_finite));
        assert!(fit.1.log_likelihood_mean.is_finite());
        fit
    }

    #[test]
    fn one_clip_has_one_component_and_gives_nothing_up() {
        let (mixture, report) = fit_draws(&draws(1, 0.5), 1, &config());
        assert_eq!(mixture.components.len(), 1);
        assert_eq!((report.attempt_count, report.fallback), (1, None));
    }

    #[test]
    fn equal_codes_end_as_a_single_gaussian() {
        for value in [0.0, 1.0, -3e38] {
            let values = vec![value; 6 * 30 * DIMENSION_COUNT];
            let (mixture, report) = fit_draws(&values, 6, &config());
            assert_eq!(mixture.components.len(), 1);
            assert_eq!(mixture.components[0].weight, 1.0);
            // Where all codes are 0, nothing is nearer to them than 0.
            let gave_up = (value != 0.0).then_some(Fallback::SingleGaussian);
            assert_eq!(report.fallback, gave_up);
        }
    }

    #[test]
    fn wide_codes_keep_a_component_for_every_clip() {
        let (mixture, report) = fit_draws(&draws(6, 0.5), 6, &config());
        assert_eq!(mixture.components.len(), 6);
        assert_eq!((report.attempt_count, report.fallback), (1, None));
    }

    #[test]
    fn narrow_codes_share_components_so_that_none_sits_on_a_clip() {
        let values = draws(20, 0.01);
        let (mixture, report) = fit_draws(&values, 20, &config());
        let points = Points { dimension_count: DIMENSION_COUNT, values: &values };
        assert_eq!(report.fallback, Some(Fallback::FewerComponents));
        assert!((2..15).contains(&mixture.components.len()));
        assert!(report.attempt_count <= 5);
        assert!(!has_collapsed(&points, &mixture, 0.1 * mean_norm(&points)));
    }

    #[test]
    fn attempts_are_capped() {
        let capped = MixtureConfig { attempts_max: 1, ..config() };
        let (mixture, report) = fit_draws(&draws(20, 0.01), 20, &capped);
        assert_eq!(mixture.components.len(), 1);
        assert_eq!((report.attempt_count, report.fallback), (2, Some(Fallback::SingleGaussian)));
    }

    #[test]
    fn collapse_distance_of_zero_allows_a_component_on_every_clip() {
        let lenient = MixtureConfig { collapse_distance: 0.0, ..config() };
        let (mixture, report) = fit_draws(&draws(20, 0.01), 20, &lenient);
        assert_eq!(mixture.components.len(), 15);
        assert_eq!(report.fallback, None);
    }

    #[test]
    fn component_count_does_not_depend_on_the_scale_of_the_codes() {
        for deviation in [0.01, 0.3] {
            let values = draws(12, deviation);
            let (expected, report) = fit_draws(&values, 12, &config());
            for scale in [100.0, 0.01, 1e-30, 1e30] {
                let scaled: Vec<f64> = values.iter().map(|value| value * scale).collect();
                let (mixture, scaled_report) = fit_draws(&scaled, 12, &config());
                assert_eq!(mixture.components.len(), expected.components.len());
                assert_eq!(scaled_report.attempt_count, report.attempt_count);
                let shift = DIMENSION_COUNT as f64 * f64::ln(scale);
                let shifted = scaled_report.log_likelihood_mean + shift;
                assert!((shifted - report.log_likelihood_mean).abs() < 1e-6);
            }
        }
    }
}
