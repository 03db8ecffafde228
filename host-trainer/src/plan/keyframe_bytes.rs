//! What keyframes of the same motions would take, at equal error.
//!
//! In:  [`Hinges`] of every clip.
//! Out: [`KeyframeReport`] to `plan.rs`.
//!
//! Why here: a model is worth its flash only against keyframes that were chosen as well as can be. Errors of position
//! are the largest at any sample; those of velocity are reported beside them, because straight lines look better in
//! position than they move.

use rayon::prelude::*;
use serde::Serialize;

use super::hinges::Hinges;
use crate::keyframe::{cubic, linear};

/// Largest errors that are compared, degrees.
pub const TOLERANCES_DEG: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// Bytes of a key of straight lines: time in 8 bits since the last key or in 16, value in 16.
const LINEAR_KEY_BYTES: [u64; 2] = [3, 4];
/// Bytes of a key of cubics: time, value and two slopes in 16 bits each; or a whole curve as Bottango's, packed.
const CUBIC_KEY_BYTES: [u64; 2] = [8, 14];
/// Every track of every clip says how many keys it has.
const TRACK_BYTES: u64 = 2;

/// Keyframes of a set of clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KeyframeReport {
    /// What the clips are.
    pub source: String,
    /// Clips.
    pub clips: usize,
    /// Their length together.
    pub seconds: f64,
    /// Curves of a pose: channels, and three angles a rotation.
    pub curves: usize,
    /// Frames as they are, one byte and two bytes a number.
    pub frame_bytes_per_s: [f64; 2],
    /// Largest error of one byte a number, degrees.
    pub byte_frame_error_deg: f64,
    /// One a tolerance.
    pub rows: Vec<KeyframeRow>,
}

/// Keyframes at one tolerance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KeyframeRow {
    /// Largest error at any sample.
    pub tolerance_deg: f64,
    /// Straight lines.
    pub linear: KeyframeCost,
    /// Cubics.
    pub cubic: KeyframeCost,
}

/// Keyframes of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KeyframeCost {
    /// Keys of all clips and curves.
    pub keys: u64,
    /// Bytes of all of them, in the smaller and in the larger way to store a key.
    pub bytes: [u64; 2],
    /// The same a second of motion.
    pub bytes_per_s: [f64; 2],
    /// The same a second and curve.
    pub bytes_per_s_per_curve: [f64; 2],
    /// Root mean square error of velocity.
    pub velocity_error_deg_per_s: f64,
}

impl KeyframeReport {
    /// Fits keyframes to every curve of every clip.
    pub fn new(source: String, clips: &[Hinges], rate_hz: f64) -> Self {
        let frames: usize = clips.iter().map(|clip| clip.frame_count).sum();
        let curves = clips.first().map_or(0, |clip| clip.curves.len());
        let seconds = frames as f64 / rate_hz;
        let per_s = |bytes: f64| bytes * curves as f64 * rate_hz;
        Self {
            source,
            clips: clips.len(),
            seconds,
            curves,
            frame_bytes_per_s: [per_s(1.0), per_s(2.0)],
            byte_frame_error_deg: byte_error_deg(clips, curves),
            rows: TOLERANCES_DEG.map(|tolerance| row(clips, tolerance, rate_hz, seconds)).to_vec(),
        }
    }
}

/// Half a step of 255 over the widest curve's range.
fn byte_error_deg(clips: &[Hinges], curves: usize) -> f64 {
    let range = |curve: usize| {
        let values = clips.iter().flat_map(|clip| &clip.curves[curve]);
        let (min, max) = values
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), v| (min.min(*v), max.max(*v)));
        (max - min).max(0.0)
    };
    (0..curves).map(range).fold(0.0, f64::max) / 255.0 / 2.0
}

/// Keys, tracks, and squared error of velocity over all steps.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    keys: u64,
    tracks: u64,
    squares: f64,
    steps: u64,
}

impl Sum {
    fn of(keys: usize, values: &[f64], played: &[f64], rate_hz: f64) -> Self {
        let steps = values.windows(2).zip(played.windows(2));
        let error = |(a, b): (&[f64], &[f64])| ((a[1] - a[0]) - (b[1] - b[0])) * rate_hz;
        Self {
            keys: keys as u64,
            tracks: 1,
            squares: steps.map(error).map(|error| error * error).sum(),
            steps: values.len().saturating_sub(1) as u64,
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            keys: self.keys + other.keys,
            tracks: self.tracks + other.tracks,
            squares: self.squares + other.squares,
            steps: self.steps + other.steps,
        }
    }

    fn cost(self, key_bytes: [u64; 2], seconds: f64, curves: usize) -> KeyframeCost {
        let bytes = key_bytes.map(|key| key * self.keys + TRACK_BYTES * self.tracks);
        let bytes_per_s = bytes.map(|bytes| bytes as f64 / seconds.max(f64::MIN_POSITIVE));
        KeyframeCost {
            keys: self.keys,
            bytes,
            bytes_per_s,
            bytes_per_s_per_curve: bytes_per_s.map(|per_s| per_s / curves.max(1) as f64),
            velocity_error_deg_per_s: (self.squares / self.steps.max(1) as f64).sqrt(),
        }
    }
}

fn row(clips: &[Hinges], tolerance_deg: f64, rate_hz: f64, seconds: f64) -> KeyframeRow {
    let of_curve = |values: &Vec<f64>| {
        let keys = linear::keys(values, tolerance_deg);
        let played = linear::play(values, &keys);
        let curves = cubic::fit(values, tolerance_deg);
        [
            Sum::of(keys.len(), values, &played, rate_hz),
            Sum::of(curves.len() + 1, values, &cubic::play(&curves), rate_hz),
        ]
    };
    let plus = |a: [Sum; 2], b: [Sum; 2]| [a[0].plus(b[0]), a[1].plus(b[1])];
    let of_clip = |clip: &Hinges| clip.curves.iter().map(of_curve).fold(Default::default(), plus);
    // In the order of the clips, so that the sums do not depend on threads.
    let sums: Vec<[Sum; 2]> = clips.par_iter().map(of_clip).collect();
    let [lines, cubics] = sums.into_iter().fold(Default::default(), plus);
    let curves = clips.first().map_or(0, |clip| clip.curves.len());
    KeyframeRow {
        tolerance_deg,
        linear: lines.cost(LINEAR_KEY_BYTES, seconds, curves),
        cubic: cubics.cost(CUBIC_KEY_BYTES, seconds, curves),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;

    fn report() -> KeyframeReport {
        let clips: Vec<Hinges> = specimen::character(10)
            .iter()
            .map(|motion| Hinges::new(&motion.layout, &motion.poses))
            .collect();
        KeyframeReport::new("test".into(), &clips, 50.0)
    }

    #[test]
    fn no_clips_are_no_bytes() {
        let report = KeyframeReport::new("none".into(), &[], 50.0);
        assert_eq!((report.clips, report.curves, report.rows[0].linear.keys), (0, 0, 0));
        assert_eq!(report.byte_frame_error_deg, 0.0);
    }

    #[test]
    fn larger_errors_take_fewer_bytes_and_all_take_less_than_frames() {
        let report = report();
        assert!(
            report
                .rows
                .is_sorted_by(|a, b| a.linear.keys > b.linear.keys && a.cubic.keys > b.cubic.keys)
        );
        assert!(report.rows[0].linear.bytes_per_s[0] < report.frame_bytes_per_s[0]);
        for row in &report.rows {
            assert!(row.cubic.keys < row.linear.keys);
            assert!(row.linear.velocity_error_deg_per_s > 0.0);
            let of_curve = row.linear.bytes_per_s_per_curve[0] * report.curves as f64;
            assert!((of_curve - row.linear.bytes_per_s[0]).abs() < 1e-9);
        }
    }
}
