//! The clips that a blob was trained on, as far as it still knows them.
//!
//! In:  a [`Model`].
//! Out: their courses, for [`nearest_repeat`](super::nearest_repeat): how alike are their most alike moments?
//!
//! Why here: what an hour repeats has to be seen beside what its clips repeat. Without variety a draw is the code of
//! the clip that is nearest in length, so asking for every length brings out the codes of (nearly) all clips; where
//! several have one length, one of them.

use std::collections::BTreeSet;

use karakuri::{ActionId, Code, Decoder, Dials, FramePosition, Model, Pcg32, Pose};

use super::{Course, followed, followed_channels};
use crate::error::Result;
use crate::host::widest_workspace;

/// A course for each clip, at `tick_hz`.
///
/// # Errors
/// A model that no workspace fits.
pub fn clip_courses(model: &Model<'_>, tick_hz: f64) -> Result<Vec<Course>> {
    let channels = followed_channels(model);
    let mut workspace = widest_workspace();
    let mut decoder = Decoder::new(model, &mut workspace)?;
    let (mut courses, mut pose) = (Vec::new(), Pose::new());
    for (code, frames) in clip_codes(model) {
        decoder.start(&code);
        let seconds =
            f64::from(frames.saturating_sub(1)) * 1000.0 / f64::from(model.rate_millihz());
        let ticks = (seconds * tick_hz) as u32 + 1;
        let course = (0..ticks).map(|tick| {
            let time_us = (f64::from(tick) / tick_hz * 1e6) as u32;
            decoder.decode(FramePosition::after_us(time_us, model.rate_millihz()), &mut pose);
            followed(&pose, &channels)
        });
        courses.push(Course { start_s: 0.0, ticks: course.collect() });
    }
    Ok(courses)
}

/// Every code that a draw without variety gives, with the first length that gives it.
fn clip_codes(model: &Model<'_>) -> Vec<(Code, u32)> {
    let dials = Dials { variety_q12: 0, ..Dials::NEUTRAL };
    let (mut seen, mut codes) = (BTreeSet::new(), Vec::new());
    for action in (0..model.actions().count() as u16).map(ActionId) {
        for frames in model.trained_frames(action) {
            let (mut random, mut code) = (Pcg32::new(1), Code::new());
            let mut draw = || random.next_u32();
            if model.sample_with(action, frames, dials, &mut draw, &mut code).is_ok()
                && seen.insert(code.values().to_vec())
            {
                codes.push((code, frames));
            }
        }
    }
    codes
}
