//! What a body is told to do, and what it tells back.
//!
//! Why here: a motion is asked for in the words of a script, milliseconds and a seed; frames are the model's affair.

use crate::fault::Fault;
use crate::limits::MARKERS_MAX;
use crate::model::ActionId;

/// One motion to play.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Intent {
    /// What to do.
    pub action: ActionId,
    /// How long, at the trained rate; rounded to whole frames of the model, whose last one ends the motion.
    pub duration_ms: u32,
    /// Which of all such motions.
    pub seed: u64,
    /// How long the way from what the body does now may take; at least 60 ms, of which the first two ticks pass before
    /// the motion's own time starts.
    pub transition_ms: u16,
    /// What to tell the caller on the way.
    pub markers: heapless::Vec<Marker, MARKERS_MAX>,
}

impl Intent {
    /// A motion with a transition of 400 ms and no markers.
    pub const fn new(action: ActionId, duration_ms: u32, seed: u64) -> Self {
        Self { action, duration_ms, seed, transition_ms: 400, markers: heapless::Vec::new() }
    }

    /// The same motion with another transition.
    pub fn over_ms(self, transition_ms: u16) -> Self {
        Self { transition_ms, ..self }
    }

    /// The same motion with one more marker, as far as [`MARKERS_MAX`] allows; more are left out.
    pub fn mark(mut self, at_ms: u32, id: u8) -> Self {
        let _ = self.markers.push(Marker { at_ms, id });
        self
    }

    /// Frames of a model of `rate_millihz`: nearest, at least one.
    pub(crate) fn frames(&self, rate_millihz: u32) -> u32 {
        let product = u64::from(self.duration_ms) * u64::from(rate_millihz);
        u32::try_from((product + 500_000) / 1_000_000).unwrap_or(u32::MAX).max(1)
    }
}

/// A moment of a motion that the caller wants to hear of: a blink, the cue of a sound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Marker {
    /// Time of the motion, at its own rate.
    pub at_ms: u32,
    /// The caller's name for it.
    pub id: u8,
}

/// What happened within the last ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// A motion has begun.
    Started(ActionId),
    /// The motion under way has passed a marker.
    Marker(u8),
    /// A motion has come to its end; one that is interrupted does not.
    Finished(ActionId),
    /// The servo stage has latched a fault and holds.
    Faulted(Fault),
}

#[cfg(test)]
mod tests {
    use super::{Intent, MARKERS_MAX};
    use crate::ActionId;

    #[test]
    fn duration_is_rounded_to_frames() {
        for (duration_ms, frames) in
            [(0, 1), (19, 1), (29, 1), (30, 2), (2400, 120), (u32::MAX, 214_748_365)]
        {
            assert_eq!(Intent::new(ActionId(0), duration_ms, 1).frames(50_000), frames);
        }
        assert_eq!(Intent::new(ActionId(0), u32::MAX, 1).frames(u32::MAX), u32::MAX);
    }

    #[test]
    fn marker_too_many_is_left_out() {
        let mut intent = Intent::new(ActionId(0), 1000, 1);
        for id in 0..10 {
            intent = intent.mark(100, id);
        }
        assert_eq!(intent.markers.len(), MARKERS_MAX);
    }
}
