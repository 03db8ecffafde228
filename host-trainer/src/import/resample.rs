//! Brings poses at irregular times to a fixed rate: rotations along the shortest arc, everything
//! else linearly.
//!
//! Source: Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985, equation for
//! slerp.

use std::path::Path;

use crate::body::rotation::Rotation;
use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout};

/// Largest distance between two recorded poses, seconds; interpolating across more would invent
/// motion.
pub const GAP_S_MAX: f64 = 1.0;

/// Largest deviation of a recorded time from the regular grid, frames.
///
/// Times that were rounded to whole milliseconds are off by 1.5 % of a frame at 30 Hz, which is no
/// irregularity.
const JITTER_FRAMES_MAX: f64 = 0.02;

/// Checks that times are finite, increase strictly, and leave no gap over [`GAP_S_MAX`].
///
/// `place` turns a pose's index into words for the error message.
pub(crate) fn check_times(
    file: &Path,
    times_s: &[f64],
    place: impl Fn(usize) -> String,
) -> Result<()> {
    if let Some(index) = times_s.iter().position(|time| !time.is_finite()) {
        let value = times_s[index];
        return Err(Error::bad_input(file, place(index), value, "a time in seconds", REPAIR));
    }
    for (index, pair) in times_s.windows(2).enumerate() {
        let step_s = pair[1] - pair[0];
        if step_s <= 0.0 {
            let (value, expected) = (pair[1], format!("a time after {}", pair[0]));
            return Err(Error::bad_input(file, place(index + 1), value, expected, REPAIR));
        }
        if step_s > GAP_S_MAX {
            let value = format!("{step_s} s after the one before");
            let expected = format!("at most {GAP_S_MAX} s");
            let remedy = "split the recording at the gap";
            return Err(Error::bad_input(file, place(index + 1), value, expected, remedy));
        }
    }
    Ok(())
}

const REPAIR: &str = "repair the times or record again";

/// The rate of a frame time, rounded to a hundredth: `0.0333333` stands for 30 Hz, `0.0333667` for
/// 29.97 Hz.
pub(crate) fn rounded_rate_hz(frame_time_s: f64) -> f64 {
    (100.0 / frame_time_s).round() / 100.0
}

/// Whether pose i lies at i / rate after the first, up to rounding.
pub(crate) fn is_regular(times_s: &[f64], rate_hz: f64) -> bool {
    let start_s = times_s.first().copied().unwrap_or(0.0);
    times_s
        .iter()
        .enumerate()
        .all(|(i, time)| ((time - start_s) * rate_hz - i as f64).abs() <= JITTER_FRAMES_MAX)
}

/// Interpolates `poses` (frame, channel), taken at checked `times_s`, at 0, 1/rate, 2/rate after
/// the first.
pub(crate) fn resample(
    layout: &PoseLayout,
    times_s: &[f64],
    poses: &[f32],
    rate_hz: f64,
) -> Vec<f32> {
    let (Some(&start_s), Some(&end_s)) = (times_s.first(), times_s.last()) else {
        return Vec::new();
    };
    let width = layout.channel_count();
    let last = ((end_s - start_s) * rate_hz + JITTER_FRAMES_MAX).floor() as usize;
    let mut resampled = Vec::with_capacity((last + 1) * width);
    let mut before = 0;
    for frame in 0..=last {
        let time_s = start_s + frame as f64 / rate_hz;
        while before + 2 < times_s.len() && times_s[before + 1] <= time_s {
            before += 1;
        }
        let after = (before + 1).min(times_s.len() - 1);
        let span_s = (times_s[after] - times_s[before]).max(f64::MIN_POSITIVE);
        let part = ((time_s - times_s[before]) / span_s).clamp(0.0, 1.0);
        let row = |index: usize| &poses[index * width..(index + 1) * width];
        blend(layout, row(before), row(after), part, &mut resampled);
    }
    resampled
}

/// Appends the pose that lies `part` (0..=1) of the way from one pose to another.
fn blend(layout: &PoseLayout, from: &[f32], to: &[f32], part: f64, out: &mut Vec<f32>) {
    for (group, range) in layout.ranges() {
        let (from, to) = (&from[range.clone()], &to[range]);
        // A rotation made of NaN would be repaired silently; a straight line keeps it NaN.
        let is_finite = from.iter().chain(to).all(|element| element.is_finite());
        if group.kind == GroupKind::Rotation6d && is_finite {
            let turned = rotation(from).slerp(&rotation(to), part);
            out.extend(turned.to_6d().map(|element| element as f32));
        } else {
            out.extend(from.iter().zip(to).map(|(&from, &to)| {
                let (from, to) = (f64::from(from), f64::from(to));
                (from + (to - from) * part) as f32
            }));
        }
    }
}

fn rotation(channels: &[f32]) -> Rotation {
    Rotation::from_6d(&std::array::from_fn(|i| f64::from(channels[i])))
}

#[cfg(test)]
mod tests {
    use super::super::support::assert_refused;
    use super::*;
    use crate::layout::{Group, Unit};

    fn layout(kinds: &[GroupKind]) -> PoseLayout {
        let group = |(index, kind): (usize, &GroupKind)| Group {
            name: format!("group{index}"),
            kind: *kind,
            unit: Unit::One,
        };
        PoseLayout { groups: kinds.iter().enumerate().map(group).collect() }
    }

    fn checked(times_s: &[f64]) -> Result<()> {
        check_times(Path::new("a.csv"), times_s, |index| format!("line {}", index + 2))
    }

    #[test]
    fn times_that_are_no_times_are_refused_with_their_place() {
        assert_refused(checked(&[0.0, f64::NAN]), &["a.csv", "line 3", "NaN"]);
        assert_refused(checked(&[0.0, 0.1, 0.1]), &["line 4 is 0.1", "a time after 0.1"]);
        assert_refused(checked(&[0.0, 0.1, 0.05]), &["line 4 is 0.05"]);
        assert_refused(checked(&[0.0, 0.1, 1.2]), &["line 4", "at most 1 s"]);
        assert!(checked(&[-5.0, -4.5, -3.5]).is_ok());
    }

    #[test]
    fn rounded_times_are_regular_and_drifting_ones_are_not() {
        assert!(is_regular(&[0.0, 0.033, 0.067, 0.1], 30.0));
        assert!(is_regular(&[1.7e9, 1.7e9 + 0.02, 1.7e9 + 0.04], 50.0));
        assert!(!is_regular(&[0.0, 0.034, 0.067], 30.0));
        assert!(!is_regular(&[0.0, 0.02, 0.04], 49.0));
    }

    #[test]
    fn frame_times_round_to_the_rates_they_stand_for() {
        let rates = [0.0333333, 0.033333, 0.0333667, 0.008333, 0.02].map(rounded_rate_hz);
        assert_eq!(rates, [30.0, 30.0, 29.97, 120.0, 50.0]);
    }

    #[test]
    fn straight_line_is_hit_exactly_at_any_rate() {
        let times_s = [3.0, 3.1, 3.15, 3.4, 3.5];
        let poses = times_s.map(|time| ((time - 3.0) * 8.0) as f32);
        let scalar = layout(&[GroupKind::Scalar]);
        for rate_hz in [2.0, 10.0, 31.0] {
            let resampled = resample(&scalar, &times_s, &poses, rate_hz);
            assert_eq!(resampled.len(), (0.5 * rate_hz) as usize + 1);
            for (frame, value) in resampled.iter().enumerate() {
                assert!((f64::from(*value) - frame as f64 / rate_hz * 8.0).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn rotation_follows_the_arc() {
        let turned = Rotation::from_rotation_vector([0.0, 0.0, 2.0]).to_6d();
        let poses: Vec<f32> =
            Rotation::IDENTITY.to_6d().iter().chain(&turned).map(|x| *x as f32).collect();
        let resampled = resample(&layout(&[GroupKind::Rotation6d]), &[0.0, 1.0], &poses, 2.0);
        let middle = Rotation::from_rotation_vector([0.0, 0.0, 1.0]);
        assert!(rotation(&resampled[6..12]).angle_to_rad(&middle) < 1e-6);
    }

    #[test]
    fn poses_on_the_grid_keep_their_bits() {
        let poses = [0.1f32, 0.7, -0.3];
        let scalar = layout(&[GroupKind::Scalar]);
        assert_eq!(resample(&scalar, &[0.0, 0.5, 1.0], &poses, 2.0), poses);
        assert_eq!(resample(&scalar, &[0.0], &[5.0], 2.0), [5.0]);
        assert_eq!(resample(&scalar, &[], &[], 2.0), Vec::<f32>::new());
    }

    #[test]
    fn value_that_is_no_number_does_not_vanish() {
        let poses = [[f32::NAN; 6], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]].concat();
        let resampled = resample(&layout(&[GroupKind::Rotation6d]), &[0.0, 1.0], &poses, 4.0);
        assert!(resampled[6..12].iter().all(|value| value.is_nan()));
    }
}
