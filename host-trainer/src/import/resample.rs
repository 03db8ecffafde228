//! Brings poses at irregular times to a fixed rate: rotations along the shortest arc, everything else linearly.
//!
//! Source: Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985, equation for slerp.

use std::path::Path;

use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout};
use crate::rotation::Rotation;

/// Largest distance between two recorded poses, seconds; interpolating across more would invent motion.
pub const GAP_S_MAX: f64 = 1.0;

/// Largest deviation of a recorded time from the regular grid, frames.
///
/// Times that were rounded to whole milliseconds are off by 1.5 % of a frame at 30 Hz, which is no irregularity.
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
        return Err(Error::bad_input(
            file,
            place(index),
            value,
            "a time in seconds",
            REPAIR,
        ));
    }
    for (index, pair) in times_s.windows(2).enumerate() {
        let step_s = pair[1] - pair[0];
        if step_s <= 0.0 {
            let (value, expected) = (pair[1], format!("a time after {}", pair[0]));
            return Err(Error::bad_input(
                file,
                place(index + 1),
                value,
                expected,
                REPAIR,
            ));
        }
        if step_s > GAP_S_MAX {
            let value = format!("{step_s} s after the one before");
            let expected = format!("at most {GAP_S_MAX} s");
            let remedy = "split the recording at the gap";
            return Err(Error::bad_input(
                file,
                place(index + 1),
                value,
                expected,
                remedy,
            ));
        }
    }
    Ok(())
}

const REPAIR: &str = "repair the times or record again";

/// The rate of a frame time, rounded to a hundredth: `0.0333333` stands for 30 Hz, `0.0333667` for 29.97 Hz.
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

/// Interpolates `poses` (frame, channel), taken at checked `times_s`, at 0, 1/rate, 2/rate, … after the first.
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
        if group.kind == GroupKind::Rotation6d {
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
