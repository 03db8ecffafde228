//! Station 5's maker: learned codes in, mixtures out.
//!
//! In:  the sequence codes' [`CodeTable`], [`DatasetDescription`], [`MixtureConfig`], a seed.
//! Out: [`MixtureSet`].
//!
//! Why here: a pure function. The same tables, configuration and seed give the same mixtures on the
//! same machine, however many threads there are, because every fit has random streams of its own.
//!
//! Source: Cervantes et al., ECCV 2022, section 3 and Algorithm 1. Differences (more in `interval`
//! and `collapse`):
//! * At most as many components as clips \[ours\]. \[published code\] counts draws, so that it fits
//!   15 components to one clip; they only cut that clip's Gaussian in pieces.
//! * The variance floor scales with the draws \[ours\]; \[published code\] fits f32 draws with 1e-6
//!   whatever their scale, and its Cholesky factor fails in one of ten starts for a clip alone.

use indicatif::{ProgressBar, ProgressStyle};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::float_model::CodeTable;
use crate::mixture::MixtureConfig;
use crate::mixture::collapse::fit_sound_mixture;
use crate::mixture::interval::{Interval, IntervalSize, build_intervals};
use crate::mixture::k_means::Points;
use crate::mixture::set::{IntervalMixture, MixtureSet};

/// Fits one mixture to every action and interval of lengths; a progress bar goes to stderr.
///
/// # Errors
/// * `BadInput`: the configuration holds a 0 or a non-finite number; there are no clips; a clip's
///   action does not exist; the code table has not one row a clip, or holds a number that is not
///   finite.
pub fn fit(
    codes: &CodeTable,
    description: &DatasetDescription,
    config: &MixtureConfig,
    seed: u64,
) -> Result<MixtureSet> {
    check_config(config)?;
    check_codes(codes, description)?;
    let size = IntervalSize {
        frames_min: config.interval_frames_min,
        clips_min: config.interval_clips_min,
    };
    let intervals = build_intervals(description, size);
    let bar = progress_bar(intervals.len());
    let intervals = intervals
        .into_par_iter()
        .with_max_len(1)
        .map(|interval| {
            let mixture = fit_interval(codes, description, interval, config, seed);
            bar.inc(1);
            mixture
        })
        .collect::<Result<Vec<_>>>();
    bar.finish_and_clear();
    Ok(MixtureSet {
        actions: description.actions.clone(),
        rate_hz: description.rate_hz,
        intervals: intervals?,
    })
}

fn fit_interval(
    codes: &CodeTable,
    description: &DatasetDescription,
    interval: Interval,
    config: &MixtureConfig,
    seed: u64,
) -> Result<IntervalMixture> {
    let streams = Streams { seed, action: interval.action, frames_min: interval.frames_min };
    let mut rng = streams.draws();
    let draws = draw_codes(codes, &interval.clips, config.draws_per_clip, &mut rng);
    let points = Points { dimension_count: codes.dimension_count, values: &draws };
    let clip_count = interval.clips.len();
    let stream = |attempt, start| streams.start(attempt, start);
    let (mixture, report) = fit_sound_mixture(&points, clip_count, config, stream)
        .ok_or_else(|| unfittable(description, &interval))?;
    Ok(IntervalMixture {
        action: interval.action,
        frames_min: interval.frames_min,
        frames_max: interval.frames_max,
        clips: interval.clips,
        mixture,
        report,
    })
}

/// `draws_per_clip` draws from every clip's Gaussian. // (clip, draw, dimension)
fn draw_codes(
    codes: &CodeTable,
    clips: &[usize],
    draws_per_clip: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<f64> {
    let dimension_count = codes.dimension_count;
    let mut draws = Vec::with_capacity(clips.len() * draws_per_clip * dimension_count);
    for row in clips {
        let range = row * dimension_count..(row + 1) * dimension_count;
        let (mean, log_variance) = (&codes.mean[range.clone()], &codes.log_variance[range]);
        for _ in 0..draws_per_clip {
            for (&mean, &log_variance) in mean.iter().zip(log_variance) {
                let noise: f64 = StandardNormal.sample(rng);
                draws.push(f64::from(mean) + (0.5 * f64::from(log_variance)).exp() * noise);
            }
        }
    }
    draws
}

/// The random streams of one interval; no two purposes share one.
struct Streams {
    seed: u64,
    action: usize,
    frames_min: usize,
}

impl Streams {
    fn draws(&self) -> ChaCha8Rng {
        self.stream("draws", 0, 0)
    }

    fn start(&self, attempt: usize, start: usize) -> ChaCha8Rng {
        self.stream("start", attempt, start)
    }

    fn stream(&self, purpose: &str, attempt: usize, start: usize) -> ChaCha8Rng {
        let Self { seed, action, frames_min } = self;
        let name = format!("{seed} {action} {frames_min} {purpose} {attempt} {start}");
        ChaCha8Rng::from_seed(Sha256::digest(name).into())
    }
}

fn check_config(config: &MixtureConfig) -> Result<()> {
    let counts = [
        ("components_max", config.components_max),
        ("draws_per_clip", config.draws_per_clip),
        ("interval_frames_min", config.interval_frames_min),
        ("interval_clips_min", config.interval_clips_min),
        ("attempts_max", config.attempts_max),
        ("restarts", config.restarts),
    ];
    for (key, count) in counts {
        if count == 0 {
            return Err(bad_config(key, count, "at least 1"));
        }
    }
    if !(config.regularization > 0.0 && config.regularization.is_finite()) {
        return Err(bad_config("regularization", config.regularization, "a number above 0"));
    }
    if !(config.collapse_distance >= 0.0 && config.collapse_distance.is_finite()) {
        return Err(bad_config("collapse_distance", config.collapse_distance, "0 or above"));
    }
    Ok(())
}

fn bad_config(key: &str, value: impl ToString, expected: &str) -> Error {
    let remedy = "change it in the configuration, or delete the line to use the preset's";
    Error::bad_input("configuration", format!("mixture.{key}"), value, expected, remedy)
}

fn check_codes(codes: &CodeTable, description: &DatasetDescription) -> Result<()> {
    let bad_codes = |field: String, value: String, expected: String| {
        let remedy = "train again, or resume from an earlier checkpoint";
        Err(Error::bad_input("sequence codes", field, value, expected, remedy))
    };
    let number_count = description.clips.len() * codes.dimension_count;
    if number_count == 0 {
        let value = format!("{} × {}", description.clips.len(), codes.dimension_count);
        return bad_codes("clips × dimensions".into(), value, "at least 1 × 1".into());
    }
    for (name, table) in [("mean", &codes.mean), ("log_variance", &codes.log_variance)] {
        if table.len() != number_count {
            let expected = format!("{number_count}, one row a clip");
            return bad_codes(format!("length of {name}"), table.len().to_string(), expected);
        }
        // A standard deviation beyond f32 would let squares of draws leave f64.
        let is_sound = |value: &f32| match name {
            "log_variance" => value.is_finite() && (0.5 * value).exp().is_finite(),
            _ => value.is_finite(),
        };
        if let Some(index) = table.iter().position(|value| !is_sound(value)) {
            let field = format!("{name} of row {}", index / codes.dimension_count);
            return bad_codes(field, table[index].to_string(), "a finite number".into());
        }
    }
    for clip in &description.clips {
        if clip.action >= description.actions.len() || clip.frame_count == 0 {
            let field = format!("clip `{}`", clip.name);
            let value = format!("{} poses of action {}", clip.frame_count, clip.action);
            let expected =
                format!("1 pose or more of an action below {}", description.actions.len());
            return bad_codes(field, value, expected);
        }
    }
    Ok(())
}

fn unfittable(description: &DatasetDescription, interval: &Interval) -> Error {
    Error::bad_input(
        format!("sequence codes of action `{}`", description.actions[interval.action]),
        format!("clips of {} to {} poses", interval.frames_min, interval.frames_max),
        "spread too wide for any Gaussian",
        "codes near the standard normal",
        "train again with a lower learning rate of the codes",
    )
}

fn progress_bar(mixture_count: usize) -> ProgressBar {
    let template = "fit {bar:40} {pos}/{len} mixtures, {elapsed} of about {duration}";
    let style = ProgressStyle::with_template(template);
    ProgressBar::new(mixture_count as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::ClipDescription;
    use crate::layout::PoseLayout;
    use crate::mixture::Covariance;

    fn config() -> MixtureConfig {
        MixtureConfig {
            components_max: 15,
            covariance: Covariance::Full,
            draws_per_clip: 50,
            interval_frames_min: 10,
            interval_clips_min: 5,
            attempts_max: 10,
            restarts: 2,
            regularization: 1e-3,
            collapse_distance: 0.1,
        }
    }

    /// `clip_count` clips of two actions, 20 to 79 poses long.
    fn description(clip_count: usize) -> DatasetDescription {
        let clip = |row: usize| ClipDescription {
            name: format!("clip{row}"),
            action: row % 2,
            frame_count: 20 + row * 37 % 60,
        };
        DatasetDescription {
            layout: PoseLayout::default(),
            rate_hz: 20.0,
            actions: vec!["bow".into(), "nod".into()],
            clips: (0..clip_count).map(clip).collect(),
            held_out: Vec::new(),
            mean: Vec::new(),
            scale: Vec::new(),
            skeleton: None,
        }
    }

    fn codes(clip_count: usize) -> CodeTable {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let number_count = clip_count * 4;
        CodeTable {
            dimension_count: 4,
            mean: (0..number_count).map(|_| StandardNormal.sample(&mut rng)).collect(),
            log_variance: vec![-2.0; number_count],
        }
    }

    fn refusal(
        codes: &CodeTable,
        description: &DatasetDescription,
        config: &MixtureConfig,
    ) -> String {
        fit(codes, description, config, 1).unwrap_err().to_string()
    }

    #[test]
    fn dataset_without_clips_is_rejected() {
        let message = refusal(&codes(0), &description(0), &config());
        assert!(message.contains("clips × dimensions is 0 × 4"), "{message}");
    }

    #[test]
    fn code_table_of_another_dataset_is_rejected() {
        let message = refusal(&codes(9), &description(10), &config());
        assert!(message.contains("length of mean is 36, expected 40"), "{message}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_rejected_with_their_row() {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut codes = codes(10);
            codes.mean[13] = value;
            let message = refusal(&codes, &description(10), &config());
            assert!(message.contains("mean of row 3 is "), "{message}");
        }
        for value in [f32::NAN, f32::NEG_INFINITY, 1000.0] {
            let mut codes = codes(10);
            codes.log_variance[39] = value;
            let message = refusal(&codes, &description(10), &config());
            assert!(message.contains("log_variance of row 9 is "), "{message}");
        }
    }

    #[test]
    fn clip_of_an_unknown_action_is_rejected() {
        let mut description = description(10);
        description.clips[4].action = 2;
        let message = refusal(&codes(10), &description, &config());
        assert!(message.contains("clip `clip4` is "), "{message}");
    }

    #[test]
    fn configuration_out_of_range_is_rejected_with_its_key() {
        let bad = [
            ("components_max", MixtureConfig { components_max: 0, ..config() }),
            ("draws_per_clip", MixtureConfig { draws_per_clip: 0, ..config() }),
            ("interval_frames_min", MixtureConfig { interval_frames_min: 0, ..config() }),
            ("interval_clips_min", MixtureConfig { interval_clips_min: 0, ..config() }),
            ("attempts_max", MixtureConfig { attempts_max: 0, ..config() }),
            ("restarts", MixtureConfig { restarts: 0, ..config() }),
            ("regularization", MixtureConfig { regularization: 0.0, ..config() }),
            ("regularization", MixtureConfig { regularization: f64::NAN, ..config() }),
            ("collapse_distance", MixtureConfig { collapse_distance: -0.1, ..config() }),
        ];
        for (key, config) in bad {
            let message = refusal(&codes(10), &description(10), &config);
            assert!(message.contains(&format!("mixture.{key} is ")), "{message}");
        }
    }

    #[test]
    fn one_clip_makes_one_mixture_of_one_component() {
        let mixtures = fit(&codes(1), &description(1), &config(), 1).unwrap();
        assert_eq!(mixtures.intervals.len(), 1);
        assert_eq!(mixtures.intervals[0].mixture.components.len(), 1);
        assert!(mixtures.trained_frames(1).is_err());
    }

    #[test]
    fn every_trained_duration_is_served_and_every_clip_has_its_share() {
        let (codes, description) = (codes(60), description(60));
        let mixtures = fit(&codes, &description, &config(), 1).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for clip in &description.clips {
            let code = mixtures.sample(clip.action, clip.frame_count, &mut rng).unwrap();
            assert!(code.len() == 4 && code.iter().all(|value| value.is_finite()));
        }
        for interval in &mixtures.intervals {
            assert!(interval.mixture.components.len() <= interval.clips.len());
            let weight: f64 = interval.mixture.components.iter().map(|c| c.weight).sum();
            assert!((weight - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn fit_is_the_same_on_any_number_of_threads_and_differs_by_seed() {
        let (codes, description) = (codes(60), description(60));
        let fit_on = |thread_count, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(thread_count).build().unwrap();
            pool.install(|| fit(&codes, &description, &config(), seed).unwrap())
        };
        assert_eq!(fit_on(1, 7), fit_on(3, 7));
        assert_ne!(fit_on(1, 7), fit_on(1, 8));
    }

    #[test]
    fn draws_match_the_mean_and_deviation_of_their_clip() {
        let codes = CodeTable {
            dimension_count: 2,
            mean: vec![9.0, 9.0, 1.0, -2.0],
            log_variance: vec![9.0, 9.0, 0.0, 4f32.ln()],
        };
        let draws = draw_codes(&codes, &[1], 20_000, &mut ChaCha8Rng::seed_from_u64(1));
        for (dimension, (mean, variance)) in [(1.0, 1.0), (-2.0, 4.0)].into_iter().enumerate() {
            let column = || draws.iter().skip(dimension).step_by(2);
            let found = column().sum::<f64>() / 20_000.0;
            let square = column().map(|x| (x - found) * (x - found)).sum::<f64>() / 20_000.0;
            assert!((found - mean).abs() < 0.05 && (square - variance).abs() < 0.1);
        }
    }

    #[test]
    fn no_two_streams_begin_alike() {
        use rand::Rng;
        let streams = Streams { seed: 1, action: 2, frames_min: 3 };
        let others = [
            Streams { seed: 2, action: 2, frames_min: 3 },
            Streams { seed: 1, action: 3, frames_min: 2 },
            Streams { seed: 1, action: 2, frames_min: 4 },
        ];
        let mut first: Vec<u64> = others.iter().map(|other| other.draws().next_u64()).collect();
        first.push(streams.draws().next_u64());
        first.extend((0..30).map(|i| streams.start(i / 10, i % 10).next_u64()));
        let count = first.len();
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), count);
    }
}
