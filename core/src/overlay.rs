//! What lies over a body's motion: breath, gaze, lids, a jaw that follows a voice.
//!
//! In:  a pose; the channels of an overlay and what it does with them; time.
//! Out: the pose with the overlay on it.
//!
//! Why here: such motion does not come from clips, and must not stop when a clip does. An overlay is a few numbers,
//! each of which glides, so that nothing that is told to an overlay can make the body jump.

use crate::error::PlayError;
use crate::inertia::Glide;
use crate::limits::{CHANNELS_MAX, OVERLAY_CHANNELS_MAX};
use crate::pose::Pose;
use crate::sine::sine_and_cosine_q15;
use crate::track::{ONE_Q16, saturate};

/// What an overlay does with the channels below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OverlayKind {
    /// Its values are added.
    Add,
    /// Its values take the place of what is below.
    Replace,
    /// Its values are added as the crests of a sine wave.
    Breathe {
        /// Milliseconds from crest to crest; 0 counts as 1.
        period_ms: u16,
    },
}

/// Values of a few channels, laid over a pose with a weight.
#[derive(Clone, Debug)]
pub struct Overlay {
    kind: OverlayKind,
    channels: heapless::Vec<u16, OVERLAY_CHANNELS_MAX>,
    values: Glide<OVERLAY_CHANNELS_MAX>,
    weight_q16: Glide<1>,
    /// Of a breath: turns · 2^32, with what is below in 2^-32 of that.
    phase: u64,
}

impl Overlay {
    /// An overlay on these channels of the pose; values and weight begin at 0, so it does nothing yet.
    ///
    /// # Errors
    /// [`PlayError::TooManyOverlays`]: more channels than fit.
    pub fn new(kind: OverlayKind, channels: &[u16]) -> Result<Self, PlayError> {
        let (count, max) = (channels.len(), OVERLAY_CHANNELS_MAX);
        let channels = heapless::Vec::from_slice(channels);
        Ok(Self {
            kind,
            channels: channels.map_err(|_| PlayError::TooManyOverlays { count, max })?,
            values: Glide::at([0; OVERLAY_CHANNELS_MAX]),
            weight_q16: Glide::at([0]),
            phase: 0,
        })
    }

    /// Sends the channels, in the order given, to these values (Q15.16 channel units) within `duration_ms`; channels
    /// without one go to 0.
    pub fn aim(&mut self, values: &[i32], duration_ms: u16) {
        let mut goals = [0; OVERLAY_CHANNELS_MAX];
        for (goal, value) in goals.iter_mut().zip(values) {
            *goal = *value;
        }
        self.values.go(goals, u32::from(duration_ms) * 1000);
    }

    /// Sends the weight to `weight_q16` (Q0.16, 0..=1) within `duration_ms`.
    pub fn fade(&mut self, weight_q16: u32, duration_ms: u16) {
        let goal = weight_q16.min(1 << 16) as i32;
        self.weight_q16.go([goal], u32::from(duration_ms) * 1000);
    }

    /// Lets time pass and lays the overlay over `pose`. Channels that the pose does not have are left out.
    pub fn apply(&mut self, elapsed_us: u32, pose: &mut Pose) {
        self.values.advance(elapsed_us);
        self.weight_q16.advance(elapsed_us);
        let [weight] = self.weight_q16.values();
        let swing_q15 = self.swing_q15(elapsed_us);
        for (channel, value) in self.channels.iter().zip(self.values.values()) {
            let Some(below) = pose.channels.get_mut(usize::from(*channel)) else {
                continue;
            };
            let difference = match self.kind {
                OverlayKind::Add => i64::from(value),
                OverlayKind::Replace => i64::from(value) - i64::from(*below),
                OverlayKind::Breathe { .. } => (i64::from(value) * i64::from(swing_q15)) >> 15,
            };
            *below = saturate(i64::from(*below) + ((difference * i64::from(weight)) >> 16));
        }
    }

    /// The sine of a breath, which begins at 0 and rises.
    fn swing_q15(&mut self, elapsed_us: u32) -> i32 {
        let OverlayKind::Breathe { period_ms } = self.kind else {
            return 0;
        };
        let period_us = u64::from(period_ms.max(1)) * 1000;
        let step = (u64::MAX / period_us).wrapping_mul(u64::from(elapsed_us));
        self.phase = self.phase.wrapping_add(step);
        let [sine, _] = sine_and_cosine_q15((self.phase >> 32) as u32);
        sine
    }
}

/// Some of a pose's channels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChannelMask([u32; CHANNELS_MAX / 32]);

impl ChannelMask {
    /// No channel.
    pub const NONE: Self = Self([0; CHANNELS_MAX / 32]);

    /// These channels and no others; numbers beyond the most that a pose can have are left out.
    pub fn of(channels: impl IntoIterator<Item = usize>) -> Self {
        let mut mask = Self::NONE;
        for channel in channels {
            if let Some(word) = mask.0.get_mut(channel / 32) {
                *word |= 1 << (channel % 32);
            }
        }
        mask
    }

    /// Whether the channel is one of them.
    pub fn contains(&self, channel: usize) -> bool {
        self.0.get(channel / 32).is_some_and(|word| word >> (channel % 32) & 1 == 1)
    }

    /// Moves the channels of the mask from `pose` towards `over` by `weight_q16` (Q0.16, 0..=1), rounded down: the arms
    /// of one motion on the body of another.
    pub fn blend(&self, over: &Pose, weight_q16: u32, pose: &mut Pose) {
        let weight = i64::from(weight_q16.min(ONE_Q16 as u32));
        let channels = pose.channels.iter_mut().zip(&over.channels).enumerate();
        for (_, (below, over)) in channels.filter(|(channel, _)| self.contains(*channel)) {
            let difference = i64::from(*over) - i64::from(*below);
            *below = saturate(i64::from(*below) + ((difference * weight) >> 16));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn pose(channels: &[i32]) -> Pose {
        Pose { channels: channels.iter().copied().collect() }
    }

    fn laid(overlay: &mut Overlay, elapsed_us: u32, channels: &[i32]) -> Vec<i32> {
        let mut pose = pose(channels);
        overlay.apply(elapsed_us, &mut pose);
        pose.channels().to_vec()
    }

    #[test]
    fn overlay_of_too_many_channels_is_refused() {
        let error = Overlay::new(OverlayKind::Add, &[0; OVERLAY_CHANNELS_MAX + 1]).unwrap_err();
        let (count, max) = (OVERLAY_CHANNELS_MAX + 1, OVERLAY_CHANNELS_MAX);
        assert_eq!(error, PlayError::TooManyOverlays { count, max });
    }

    #[test]
    fn overlay_on_a_channel_that_the_pose_does_not_have_does_nothing() {
        let mut overlay = Overlay::new(OverlayKind::Replace, &[300, 2]).unwrap();
        overlay.aim(&[5, 5], 0);
        overlay.fade(1 << 16, 0);
        assert_eq!(laid(&mut overlay, 1000, &[1, 2]), [1, 2]);
    }

    #[test]
    fn values_are_added_or_take_the_place_of_what_is_below() {
        let ways =
            [(OverlayKind::Add, 1050, [1100, 7, 1800]), (OverlayKind::Replace, 550, [100, 7, 800])];
        for (kind, half, whole) in ways {
            let mut overlay = Overlay::new(kind, &[2, 0]).unwrap();
            overlay.aim(&[800, 100], 0);
            overlay.fade(1 << 15, 0);
            assert_eq!(laid(&mut overlay, 1, &[1000, 7, 1000])[0], half);
            overlay.fade(1 << 16, 0);
            assert_eq!(laid(&mut overlay, 1, &[1000, 7, 1000]), whole);
        }
    }

    #[test]
    fn gaze_glides_to_its_goal_and_stays() {
        let mut overlay = Overlay::new(OverlayKind::Add, &[0]).unwrap();
        overlay.fade(1 << 16, 0);
        overlay.aim(&[1 << 16], 200);
        let course: Vec<i32> = (0..30).map(|_| laid(&mut overlay, 10_000, &[0])[0]).collect();
        assert!(
            course.windows(2).all(|pair| (0..8000).contains(&(pair[1] - pair[0]))),
            "{course:?}"
        );
        assert_eq!(course[20..], [1 << 16; 10]);
    }

    #[test]
    fn breath_returns_after_its_period_and_does_not_drift() {
        let mut overlay = Overlay::new(OverlayKind::Breathe { period_ms: 4000 }, &[0]).unwrap();
        overlay.aim(&[1 << 16], 0);
        overlay.fade(1 << 16, 0);
        let course: Vec<i32> = (0..180_000).map(|_| laid(&mut overlay, 20_000, &[0])[0]).collect();
        assert_eq!(course.iter().max(), Some(&65_534));
        // An hour later within 2^-16 of a crest.
        for tick in 0..200 {
            assert!((course[tick] - course[tick + 179_800]).abs() <= 4, "{tick}");
        }
    }

    #[test]
    fn mask_blends_its_channels_only() {
        let mask = ChannelMask::of([0, 2, 9999]);
        assert!(mask.contains(2) && !mask.contains(1) && !mask.contains(9999));
        let mut below = pose(&[0, 0, 100]);
        mask.blend(&pose(&[100, 100, 0]), 1 << 15, &mut below);
        assert_eq!(below.channels(), [50, 0, 50]);
    }
}
