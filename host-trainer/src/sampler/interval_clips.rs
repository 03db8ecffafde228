//! Clips' codes by length intervals, one byte a number: what blobs held before `nearest_clips`.
//!
//! In:  clips' codes, and the intervals of the mixtures.
//! Out: sequence codes. Blobs also hold a factor on the noise of each interval, which made no difference.

use rand_chacha::ChaCha8Rng;

use super::nearest_clips::{add_noise, between, shared_deviations};
use super::{StoredSampler, code_rows};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::evaluate::source::CodeSampler;
use crate::mixture::set::MixtureSet;

/// Largest step towards another clip of the interval, as a share of the way.
pub const STEP_MAX: f64 = 0.2;
/// Bytes of a member and of an interval.
const RECORD_BYTES: [usize; 2] = [4, 16];

/// See the module.
#[derive(Clone, Debug)]
pub struct IntervalClips<'a> {
    rows: Vec<Vec<f64>>,
    deviations: Vec<f64>,
    intervals: &'a MixtureSet,
}

impl<'a> IntervalClips<'a> {
    /// Stores the clips' codes at one byte a number.
    pub fn new(checkpoint: &Checkpoint, intervals: &'a MixtureSet) -> Self {
        let mut rows = code_rows(checkpoint);
        round_columns(&mut rows);
        Self { rows, deviations: shared_deviations(&checkpoint.sequence_codes), intervals }
    }
}

/// One byte a number: −127..=127 steps of its column.
pub(super) fn round_columns(rows: &mut [Vec<f64>]) {
    for column in 0..rows.first().map_or(0, Vec::len) {
        let largest = rows.iter().map(|row| row[column].abs()).fold(0.0, f64::max);
        let step = largest.max(1e-6) / 127.0;
        rows.iter_mut().for_each(|row| row[column] = (row[column] / step).round() * step);
    }
}

impl CodeSampler for IntervalClips<'_> {
    fn name(&self) -> String {
        let count = self.intervals.intervals.len();
        format!("clips of {count} intervals, step {:.0} %, 8 bits a number", 100.0 * STEP_MAX)
    }

    fn sample(&self, action: usize, frames: usize, random: &mut ChaCha8Rng) -> Result<Vec<f32>> {
        let interval = self.intervals.interval(action, frames)?;
        Ok(between(&self.rows, &interval.clips, STEP_MAX, random)
            .zip(&self.deviations)
            .map(|(value, deviation)| add_noise(value, *deviation, random))
            .collect())
    }
}

impl StoredSampler for IntervalClips<'_> {
    fn bytes(&self) -> usize {
        let dimensions = self.deviations.len();
        let members: usize = self.intervals.intervals.iter().map(|i| i.clips.len()).sum();
        let [member, interval] = RECORD_BYTES;
        let tables = member * members + interval * self.intervals.intervals.len();
        self.rows.len() * dimensions + 8 * dimensions + tables
    }
}
