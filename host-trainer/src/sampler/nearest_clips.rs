//! The device's sampler: a clip's own code, of the clips of the action that are nearest in length.
//!
//! In:  clips' codes as a [`Coding`] stores them.
//! Out: sequence codes; orders and columns to `quantize`.
//!
//! Why here: intervals of lengths leave the clips at their ends with half of their neighbours, and rare lengths with
//! hardly a choice. A window that slides over the clips in order of length always holds equally many, as many shorter
//! as longer ones, and needs 2 bytes a clip where intervals with members need 6. On HumanAct12 it also scores better.

use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::coding::{Coded, Coding};
use super::{StoredSampler, code_rows};
use crate::checkpoint::Checkpoint;
use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::evaluate::source::CodeSampler;
use crate::float_model::CodeTable;

/// How clips become motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipOptions {
    /// Clips of nearest length that a motion is drawn from.
    pub clip_count: usize,
    /// Largest step towards another of them, as a share of the way.
    pub step_max: f64,
    /// Factor on the learned noise.
    pub noise: f64,
    /// Bits of a number, on average.
    pub bits_mean: f64,
}

impl ClipOptions {
    /// By the front of ARCHITECTURE.md, "How motions are drawn".
    pub const DEFAULT: Self = Self { clip_count: 5, step_max: 0.05, noise: 1.0, bits_mean: 5.0 };
}

/// Bytes of the device's record of an action.
const ACTION_BYTES: usize = 16;
/// Bytes of the length of a clip.
const LENGTH_BYTES: usize = 2;

/// Clips of one action, ascending in length.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionClips {
    /// Index into the dataset's actions.
    pub action: usize,
    /// Rows of the code table.
    pub clips: Vec<usize>,
    /// Poses of each. // (clip)
    pub lengths: Vec<usize>,
}

impl ActionClips {
    /// Of every action that has clips.
    pub fn of_dataset(description: &DatasetDescription) -> Vec<Self> {
        let of_action = |action: usize| {
            let clips = description.clips.iter().enumerate();
            let mut clips: Vec<(usize, usize)> = clips
                .filter(|(_, clip)| clip.action == action)
                .map(|(row, clip)| (clip.frame_count, row))
                .collect();
            clips.sort_unstable();
            let (lengths, clips) = clips.into_iter().unzip();
            Self { action, clips, lengths }
        };
        let actions = (0..description.actions.len()).map(of_action);
        actions.filter(|action| !action.clips.is_empty()).collect()
    }

    /// Positions of the `count` clips nearest in length; as `karakuri` chooses them.
    fn nearest(&self, frames: usize, count: usize) -> std::ops::Range<usize> {
        let shorter = self.lengths.partition_point(|&length| length < frames);
        let not_longer = self.lengths.partition_point(|&length| length <= frames);
        let count = count.min(self.clips.len());
        let skipped = ((shorter + not_longer) / 2).saturating_sub(count / 2);
        let first = skipped.min(self.clips.len() - count);
        first..first + count
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub struct NearestClips {
    options: ClipOptions,
    actions: Vec<ActionClips>,
    coded: Coded,
    /// σ of the noise. // (dimension)
    deviations: Vec<f64>,
    names: Vec<String>,
}

impl NearestClips {
    /// Stores the clips' codes.
    pub fn new(checkpoint: &Checkpoint, coding: Coding, options: ClipOptions) -> Self {
        let learned = shared_deviations(&checkpoint.sequence_codes);
        let coded = coding.code(checkpoint, &code_rows(checkpoint), &learned);
        let deviations = quiet(&learned, &coded.square_errors);
        Self {
            options,
            actions: ActionClips::of_dataset(&checkpoint.dataset),
            coded,
            deviations: deviations.iter().map(|deviation| options.noise * deviation).collect(),
            names: checkpoint.dataset.actions.clone(),
        }
    }

    fn action(&self, action: usize, frames: usize) -> Result<&ActionClips> {
        let clips = self.actions.iter().find(|clips| clips.action == action);
        let trained = clips.map(|clips| (clips.lengths[0], clips.lengths[clips.lengths.len() - 1]));
        match clips.zip(trained) {
            Some((clips, (min, max))) if (min..=max).contains(&frames) => Ok(clips),
            _ => Err(Error::bad_input(
                format!("action `{}`", self.names.get(action).map_or("", String::as_str)),
                "length",
                format!("{frames} frames"),
                trained.map_or("clips".to_owned(), |(min, max)| format!("{min} to {max} frames")),
                "ask for a length of its clips, or add --clamp to take the nearest",
            )),
        }
    }
}

impl CodeSampler for NearestClips {
    fn name(&self) -> String {
        let ClipOptions { clip_count, step_max, noise, .. } = self.options;
        let percent = 100.0 * step_max;
        let noise = if noise == 1.0 { String::new() } else { format!(", σ × {noise}") };
        format!("{clip_count} nearest clips, step {percent:.0} %{noise}, {}", self.coded.name)
    }

    fn sample(&self, action: usize, frames: usize, random: &mut ChaCha8Rng) -> Result<Vec<f32>> {
        let clips = self.action(action, frames)?;
        let near = clips.nearest(frames, self.options.clip_count);
        Ok(between(&self.coded.rows, &clips.clips[near], self.options.step_max, random)
            .zip(&self.deviations)
            .map(|(value, deviation)| add_noise(value, *deviation, random))
            .collect())
    }
}

impl StoredSampler for NearestClips {
    fn bytes(&self) -> usize {
        let clip_count = self.coded.rows.len();
        let actions = ACTION_BYTES * self.actions.len() + LENGTH_BYTES * clip_count;
        self.coded.bytes + actions + 4 * self.deviations.len()
    }
}

/// One of the clips' codes, moved by up to `step_max` of the way towards another one's.
pub(super) fn between<'a, R: Rng + ?Sized>(
    rows: &'a [Vec<f64>],
    clips: &[usize],
    step_max: f64,
    random: &mut R,
) -> impl Iterator<Item = f64> + use<'a, R> {
    let chosen = random.random_range(0..clips.len());
    // Any of the others with equal chance; the clip itself when it is alone.
    let skip = if clips.len() > 1 { random.random_range(1..clips.len()) } else { 0 };
    let fraction = step_max * random.random::<f64>();
    let (from, to) = (&rows[clips[chosen]], &rows[clips[(chosen + skip) % clips.len()]]);
    from.iter().zip(to).map(move |(from, to)| from + fraction * (to - from))
}

pub(super) fn add_noise<R: Rng + ?Sized>(value: f64, deviation: f64, random: &mut R) -> f32 {
    let noise: f64 = StandardNormal.sample(random);
    (value + deviation * noise) as f32
}

/// Root mean square over the clips of what training has learned to be noise. // (dimension)
pub fn shared_deviations(codes: &CodeTable) -> Vec<f64> {
    let rows = codes.log_variance.chunks_exact(codes.dimension_count);
    let mut variances = vec![0.0; codes.dimension_count];
    for row in rows {
        variances.iter_mut().zip(row).for_each(|(sum, &log)| *sum += f64::from(log).exp());
    }
    let count = codes.row_count().max(1) as f64;
    variances.iter().map(|sum| (sum / count).sqrt()).collect()
}

/// What is left of the noise once rounding has added its own.
pub fn quiet(deviations: &[f64], square_errors: &[f64]) -> Vec<f64> {
    let rest = |(deviation, error): (&f64, &f64)| (deviation * deviation - error).max(0.0).sqrt();
    deviations.iter().zip(square_errors).map(rest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clips(lengths: &[usize]) -> ActionClips {
        let clips = (0..lengths.len()).collect();
        ActionClips { action: 0, clips, lengths: lengths.to_vec() }
    }

    #[test]
    fn nearest_clips_lie_on_both_sides_of_the_length() {
        let clips = clips(&[10, 12, 14, 20, 20, 20, 33, 40]);
        assert_eq!(clips.nearest(20, 3), 3..6);
        assert_eq!(clips.nearest(16, 2), 2..4);
        assert_eq!(clips.nearest(10, 4), 0..4);
        assert_eq!(clips.nearest(40, 4), 4..8);
        assert_eq!(clips.nearest(25, 99), 0..8);
    }

    #[test]
    fn rounding_takes_the_place_of_noise() {
        assert_eq!(
            quiet(&[0.5, 0.3, 0.1], &[0.0, 0.05, 1.0])[..],
            [0.5, 0.2, 0.0]
                .map(|x: f64| { if x == 0.2 { (0.3_f64 * 0.3 - 0.05).sqrt() } else { x } })
        );
    }
}
