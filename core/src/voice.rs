//! A stream of poses: one body that always moves on from where it is.
//!
//! In:  motions to begin; the time since the last pose.
//! Out: a [`Pose`] at any rate, continuous in position and velocity whatever is begun when.
//!
//! Why here: the decoder makes poses of one motion at its own rate. A voice puts the curve of `track.rs` through them,
//! carries the body over from one motion to the next by `inertia.rs`, and decodes at most one pose a tick, so that a
//! switch costs a slow chip no dropped tick. [`Player`](crate::Player) has one; a body with a second model (a face of
//! its own, say) gives that a voice of its own and blends the poses by a [`ChannelMask`](crate::ChannelMask).

use crate::code::Code;
use crate::decoder::Decoder;
use crate::dials::Dials;
use crate::error::{PlayError, SampleError};
use crate::inertia::{Fading, Inertia};
use crate::model::{ActionId, Model};
use crate::pose::Pose;
use crate::random::Pcg32;
use crate::time_embedding::FramePosition;
use crate::track::{KeyWeights, Track, saturate};

/// Frames of a motion from its first key to its last, Q16.16, and the distance of keys, in frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Keys {
    count: u32,
    distance_q16: u32,
}

impl Keys {
    /// Keys every `frames_per_key` frames or a little closer, so that the last one is the motion's last frame.
    fn new(frames: u32, frames_per_key: u8) -> Self {
        let last_q16 = frames.saturating_sub(1).min(u32::from(u16::MAX)) << 16;
        let count = (last_q16 >> 16).div_ceil(u32::from(frames_per_key)).max(1);
        Self { count, distance_q16: last_q16 / count }
    }

    fn position(self, key: u32) -> FramePosition {
        FramePosition::from_bits(key * self.distance_q16)
    }
}

/// What the voice is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Stands, or is about to.
    Resting,
    /// On its way to a motion's first pose; `decoded` of its first keys are there, one more a tick.
    Starting { decoded: u32 },
    /// In a motion, after this key.
    Moving { key: u32 },
}

/// A body that moves. `CHANNELS`: at least those of the model. 2.2 KB and 24 bytes a channel.
#[derive(Debug)]
pub struct Voice<'m, 'w, const CHANNELS: usize> {
    model: &'m Model<'m>,
    decoder: Decoder<'m, 'w>,
    frames_per_key: u8,
    phase: Phase,
    keys: Keys,
    /// Time of the motion since its first key, with the rest below a microsecond in Q0.16.
    clock_us: u32,
    clock_rest_q16: u32,
    /// Microseconds of a motion's time per one of the body's, Q16.
    rate_q16: u32,
    place_q16: u32,
    track: Track<CHANNELS>,
    inertia: Inertia<CHANNELS>,
    code: Code,
    pose: Pose,
}

/// Shortest transition: what is left of one when a motion's time starts.
const TRANSITION_US_MIN: u32 = 60_000;
/// How long a body takes to stand after a motion.
const SETTLE_US: u32 = 300_000;
/// Rates change by at most this much a second, Q16: from the trained speed to the doubled in half a second.
const RATE_SLEW_PER_S_Q16: u64 = 2 << 16;

impl<'m, 'w, const CHANNELS: usize> Voice<'m, 'w, CHANNELS> {
    /// A body at rest with all channels 0, until [`stand`](Self::stand) or [`begin`](Self::begin).
    ///
    /// `frames_per_key`: frames of the model between two decoded poses. 1 follows the model exactly at its frames;
    /// 2 halves the work. What lies between is a spline.
    ///
    /// # Errors
    /// [`PlayError::TooManyChannels`].
    pub fn new(
        model: &'m Model<'m>,
        decoder: Decoder<'m, 'w>,
        frames_per_key: u8,
    ) -> Result<Self, PlayError> {
        let (count, max) = (model.channel_count(), CHANNELS);
        if count > max {
            return Err(PlayError::TooManyChannels { count, max });
        }
        let mut pose = Pose::new();
        for _ in 0..count {
            // At most CHANNELS_MAX, which the loader has seen to.
            let _ = pose.channels.push(0);
        }
        Ok(Self {
            model,
            decoder,
            frames_per_key: frames_per_key.max(1),
            phase: Phase::Resting,
            keys: Keys::new(1, 1),
            clock_us: 0,
            clock_rest_q16: 0,
            rate_q16: 1 << 16,
            place_q16: 0,
            track: Track::still(&[]),
            inertia: Inertia::none(),
            code: Code::new(),
            pose,
        })
    }

    /// The model.
    pub fn model(&self) -> &'m Model<'m> {
        self.model
    }

    /// The pose of the last tick.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// The same, to be changed before it goes on; the voice moves on from its own.
    pub(crate) fn pose_mut(&mut self) -> &mut Pose {
        &mut self.pose
    }

    /// Whether no motion is under way; the body may still be settling.
    pub fn is_resting(&self) -> bool {
        self.phase == Phase::Resting
    }

    /// Whether nothing moves.
    pub fn is_still(&self) -> bool {
        self.is_resting() && self.inertia.remaining_us() == 0
    }

    /// Time of the motion under way since its first pose, µs: runs at its rate, stands while it starts.
    pub fn motion_us(&self) -> u32 {
        if matches!(self.phase, Phase::Moving { .. }) { self.clock_us } else { 0 }
    }

    /// Draws a motion of `frames` and goes over to it within `transition_us`, from whatever the body is doing. The
    /// motion's own time starts two ticks later, when its first three keys are decoded.
    ///
    /// # Cost
    /// The code half and one pose.
    ///
    /// # Errors
    /// [`SampleError`]; the body then goes on as before.
    pub fn begin(
        &mut self,
        action: ActionId,
        frames: u32,
        seed: u64,
        dials: Dials,
        transition_us: u32,
    ) -> Result<(), SampleError> {
        let mut random = Pcg32::new(seed);
        let mut draw = || random.next_u32();
        self.model.sample_with(action, frames, dials, &mut draw, &mut self.code)?;
        self.keys = Keys::new(frames, self.frames_per_key);
        self.decoder.start(&self.code);
        self.carry_over(transition_us, |voice| {
            voice.decode(0);
            voice.track.stand(&voice.pose.channels);
            voice.phase = Phase::Starting { decoded: 1 };
            (voice.clock_us, voice.clock_rest_q16, voice.place_q16) = (0, 0, 0);
        });
        Ok(())
    }

    /// Ends the motion under way: the body runs out within `duration_us`, without turning back, and stands.
    pub fn settle(&mut self, duration_us: u32) {
        let duration_us = duration_us.max(1);
        let (values, slopes) = (self.current(), self.velocity(duration_us));
        let mut goal = [0; CHANNELS];
        for (goal, (value, slope)) in goal.iter_mut().zip(values.iter().zip(&slopes)) {
            *goal = value.saturating_add(slope / 2);
        }
        self.track.stand(&goal);
        self.phase = Phase::Resting;
        let ahead = values.iter().zip(&goal).map(|(value, goal)| value.saturating_sub(*goal));
        self.inertia.begin(duration_us, ahead.zip(slopes));
    }

    /// Stands in this pose at once, without a transition: for a body that nobody drives yet.
    pub fn stand(&mut self, pose: &[i32]) {
        self.track.stand(pose);
        self.phase = Phase::Resting;
        self.inertia.begin(0, core::iter::empty());
        self.compose();
    }

    /// Lets time pass and works out the pose; `rate_q12` as [`Dials::rate_q12`].
    ///
    /// # Cost
    /// At most one decoded pose where keys are no closer than ticks, otherwise as many as passed (up to 4).
    pub fn advance(&mut self, elapsed_us: u32, rate_q12: u16) -> &Pose {
        self.slew_rate(elapsed_us, u32::from(rate_q12) << 4);
        self.inertia.advance(elapsed_us);
        match self.phase {
            Phase::Resting => {}
            Phase::Starting { decoded } => self.start(decoded),
            Phase::Moving { key } => {
                self.advance_clock(elapsed_us);
                self.follow(key);
            }
        }
        self.compose();
        &self.pose
    }

    /// Time since the motion's first key at which it ends, µs at its own rate.
    pub fn duration_us(&self) -> u32 {
        let frames_q16 = u64::from(self.keys.count * self.keys.distance_q16);
        let us = (frames_q16 * 1_000_000_000) / u64::from(self.model.rate_millihz().max(1));
        (us >> 16) as u32
    }

    /// Decodes another of the first keys, until three are there and time can start. Before that the body heads for the
    /// first key, where its place stays.
    fn start(&mut self, decoded: u32) {
        if decoded == 1 {
            self.decode(1);
            self.track.put::<2>(&self.pose.channels);
            self.phase = Phase::Starting { decoded: 2 };
            return;
        }
        let has_third = self.keys.count >= 2;
        if has_third {
            self.decode(2);
        }
        self.carry_over(self.inertia.remaining_us(), |voice| {
            if has_third {
                voice.track.put::<3>(&voice.pose.channels);
            }
            voice.track.fill_ends(!has_third);
            voice.phase = Phase::Moving { key: 0 };
        });
    }

    fn slew_rate(&mut self, elapsed_us: u32, goal_q16: u32) {
        let step = (u64::from(elapsed_us) * RATE_SLEW_PER_S_Q16 / 1_000_000) as u32;
        let least = self.rate_q16.saturating_sub(step);
        self.rate_q16 = goal_q16.clamp(least, self.rate_q16.saturating_add(step));
    }

    fn advance_clock(&mut self, elapsed_us: u32) {
        let passed = u64::from(elapsed_us) * u64::from(self.rate_q16);
        let passed = passed + u64::from(self.clock_rest_q16);
        self.clock_rest_q16 = (passed & 0xFFFF) as u32;
        self.clock_us = self.clock_us.saturating_add((passed >> 16) as u32);
    }

    /// Finds the place between keys, and decodes those that come into sight.
    fn follow(&mut self, mut key: u32) {
        let position = FramePosition::after_us(self.clock_us, self.model.rate_millihz()).to_bits();
        let distance_q16 = self.keys.distance_q16.max(1);
        let goal = (position / distance_q16).min(self.keys.count);
        // Four keys are all that is seen at once: what came and went within this tick is left out.
        for next in (key + 1).max(goal.saturating_sub(3))..=goal {
            if next + 2 <= self.keys.count {
                self.decode(next + 2);
                self.track.push(&self.pose.channels);
            } else {
                self.track.push_beyond();
            }
        }
        key = goal;
        let past = u64::from(position.saturating_sub(key * distance_q16));
        self.place_q16 = ((past << 16) / u64::from(distance_q16)).min(1 << 16) as u32;
        self.phase = Phase::Moving { key };
        if key >= self.keys.count {
            self.place_q16 = 0;
            self.settle(SETTLE_US);
        }
    }

    fn decode(&mut self, key: u32) {
        self.decoder.decode(self.keys.position(key), &mut self.pose);
    }

    /// Changes what the body does; the difference at this instant fades within `duration_us`.
    fn carry_over(&mut self, duration_us: u32, change: impl FnOnce(&mut Self)) {
        let duration_us = duration_us.max(TRANSITION_US_MIN);
        let (values, slopes) = (self.current(), self.velocity(duration_us));
        change(self);
        self.inertia.begin(0, core::iter::empty());
        let (new_values, new_slopes) = (self.current(), self.velocity(duration_us));
        let offsets = values.iter().zip(&new_values).map(|(old, new)| old.saturating_sub(*new));
        let drifts = slopes.iter().zip(&new_slopes).map(|(old, new)| old.saturating_sub(*new));
        self.inertia.begin(duration_us, offsets.zip(drifts));
    }

    /// Every channel now.
    fn current(&self) -> [i32; CHANNELS] {
        let mut values = [0; CHANNELS];
        fill(&mut values, self.track.weighted(KeyWeights::value(self.place_q16)));
        if let Some(place_q16) = self.inertia.place_q16() {
            add(&mut values, self.inertia.weighted(Fading::value(place_q16)));
        }
        values
    }

    /// Every channel's velocity now, per `duration_us`.
    fn velocity(&self, duration_us: u32) -> [i32; CHANNELS] {
        let mut values = [0; CHANNELS];
        if matches!(self.phase, Phase::Moving { .. }) {
            fill(&mut values, self.track.weighted(KeyWeights::slope(self.place_q16)));
            let frames_q16 = FramePosition::after_us(duration_us, self.model.rate_millihz());
            let frames_q16 = (u64::from(frames_q16.to_bits()) * u64::from(self.rate_q16)) >> 16;
            let keys_q16 = (frames_q16 << 16) / u64::from(self.keys.distance_q16.max(1));
            scale(&mut values, keys_q16 as i64);
        }
        if let Some(place_q16) = self.inertia.place_q16() {
            let mut fading = [0; CHANNELS];
            fill(&mut fading, self.inertia.weighted(Fading::slope(place_q16)));
            let share_q16 = (u64::from(duration_us) << 16) / u64::from(self.inertia.duration_us());
            scale(&mut fading, share_q16 as i64);
            add(&mut values, fading.into_iter());
        }
        values
    }

    fn compose(&mut self) {
        let values = self.current();
        fill(&mut self.pose.channels, values.into_iter());
    }
}

fn fill(values: &mut [i32], with: impl Iterator<Item = i32>) {
    for (value, with) in values.iter_mut().zip(with) {
        *value = with;
    }
}

fn add(values: &mut [i32], more: impl Iterator<Item = i32>) {
    for (value, more) in values.iter_mut().zip(more) {
        *value = value.saturating_add(more);
    }
}

fn scale(values: &mut [i32], factor_q16: i64) {
    for value in values {
        *value = saturate(i64::from(*value).saturating_mul(factor_q16) >> 16);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::SamplerKind;
    use crate::specimen::specimen;
    use crate::{NumberFormat, Workspace};
    use std::vec::Vec;

    const KIND: SamplerKind = SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 };
    const TICK_US: u32 = 20_000;
    const ONE: u16 = Dials::ONE_Q12;

    /// Runs a test with a voice of a small model: two actions, 10 to 30 and more frames.
    fn with_voice(frames_per_key: u8, test: impl FnOnce(&mut Voice<'_, '_, 4>)) {
        let blob = specimen(NumberFormat::W8A16, KIND);
        let model = Model::from_bytes(&blob).unwrap();
        let mut workspace = Workspace::<8>::new();
        let decoder = Decoder::new(&model, &mut workspace).unwrap();
        test(&mut Voice::new(&model, decoder, frames_per_key).unwrap());
    }

    fn begin(voice: &mut Voice<'_, '_, 4>, seed: u64) {
        voice.begin(ActionId(0), 20, seed, Dials::NEUTRAL, 400_000).unwrap();
    }

    fn channels(pose: &Pose) -> Vec<i64> {
        pose.channels().iter().map(|&channel| i64::from(channel)).collect()
    }

    #[test]
    fn model_with_more_channels_than_the_voice_is_refused() {
        let blob = specimen(NumberFormat::W8A16, KIND);
        let model = Model::from_bytes(&blob).unwrap();
        let mut workspace = Workspace::<8>::new();
        let decoder = Decoder::new(&model, &mut workspace).unwrap();
        let error = Voice::<3>::new(&model, decoder, 1).unwrap_err();
        assert_eq!(error, PlayError::TooManyChannels { count: 4, max: 3 });
    }

    #[test]
    fn motion_that_cannot_be_drawn_leaves_the_body_as_it_was() {
        with_voice(1, |voice| {
            begin(voice, 1);
            for _ in 0..20 {
                voice.advance(TICK_US, ONE);
            }
            let before = (voice.pose.clone(), voice.phase, voice.clock_us);
            let error = voice.begin(ActionId(0), 9999, 1, Dials::NEUTRAL, 0).unwrap_err();
            assert!(matches!(error, SampleError::OutsideTraining { frames: 9999, .. }));
            assert_eq!((voice.pose.clone(), voice.phase, voice.clock_us), before);
        });
    }

    #[test]
    fn keys_begin_and_end_with_the_motion() {
        for (frames, per_key, count, distance) in
            [(20, 1, 19, 1.0), (20, 2, 10, 1.9), (20, 255, 1, 19.0), (1, 1, 1, 0.0), (0, 3, 1, 0.0)]
        {
            let keys = Keys::new(frames, per_key);
            assert_eq!((keys.count, keys.distance_q16), (count, (distance * 65_536.0) as u32));
        }
    }

    #[test]
    fn body_follows_the_decoder_once_the_transition_is_over() {
        with_voice(1, |voice| {
            let rate = voice.model().rate_millihz();
            voice.begin(ActionId(0), 20, 3, Dials::NEUTRAL, 60_000).unwrap();
            let (mut met, mut exact) = (0, Pose::new());
            for _ in 0..20_000 {
                voice.advance(100, ONE);
                let at = FramePosition::after_us(voice.clock_us, rate).to_bits();
                let is_over = voice.inertia.place_q16().is_none() && !voice.is_resting();
                if is_over && at % 65_536 < 256 {
                    let found = channels(voice.pose());
                    voice.decoder.decode(FramePosition::from_frames(at >> 16), &mut exact);
                    for (found, exact) in found.iter().zip(channels(&exact)) {
                        // Within 1/256 of a frame, in which no channel goes farther.
                        assert!((found - exact).abs() < 2000, "{found}, {exact}");
                    }
                    met += 1;
                }
            }
            assert!(met > 10, "{met}");
        });
    }

    #[test]
    fn motion_lasts_as_long_as_its_frames_at_any_rate_and_tick() {
        for (rate_q12, tick_us) in
            [(ONE, 20_000), (ONE, 16_667), (2 * ONE, 5_000), (ONE / 2, 10_001)]
        {
            with_voice(2, |voice| {
                voice.rate_q16 = u32::from(rate_q12) << 4;
                begin(voice, 3);
                let (mut ticks, mut moving) = (0, 0);
                while !voice.is_resting() {
                    voice.advance(tick_us, rate_q12);
                    ticks += 1;
                    moving += u32::from(matches!(voice.phase, Phase::Moving { .. }));
                }
                let expected =
                    u64::from(voice.duration_us()) * u64::from(ONE) / u64::from(rate_q12);
                let passed = u64::from(moving) * u64::from(tick_us);
                assert!(
                    passed.abs_diff(expected) <= 2 * u64::from(tick_us),
                    "{passed}, {expected}"
                );
                assert_eq!(ticks - moving, 2, "ticks until the motion's time starts");
            });
        }
    }

    /// Largest jump and largest kink of any channel over a course, in units of its own largest speed and acceleration
    /// elsewhere.
    #[test]
    fn no_switch_jumps_or_kinks() {
        let mut random = Pcg32::new(1);
        with_voice(1, |voice| {
            let tick_us = 1_000;
            let mut last: Option<Vec<i64>> = None;
            let mut last_speed: Option<Vec<i64>> = None;
            let (mut speed_max, mut kink_max) = (0, 0);
            for tick in 0..1_000_000u32 {
                match random.next_u32() % 1000 {
                    0..=9 => begin(voice, u64::from(tick)),
                    10 => voice.settle(300_000),
                    _ => {}
                }
                let rate_q12 = if tick % 4000 < 2000 { ONE } else { 2 * ONE };
                let now = channels(voice.advance(tick_us, rate_q12));
                if let Some(last) = &last {
                    let speed: Vec<i64> = now.iter().zip(last).map(|(a, b)| a - b).collect();
                    if let Some(last_speed) = &last_speed {
                        let kinks = speed.iter().zip(last_speed).map(|(a, b)| (a - b).abs());
                        kink_max = kink_max.max(kinks.max().unwrap());
                    }
                    speed_max = speed_max.max(speed.iter().map(|speed| speed.abs()).max().unwrap());
                    last_speed = Some(speed);
                }
                last = Some(now);
            }
            // A kink would be as large as a speed. What is left is the acceleration of a millisecond.
            std::println!(
                "largest step {speed_max}, largest change of it {kink_max}, of 2^-16 units"
            );
            assert!(speed_max > 1000 && kink_max * 20 < speed_max, "{speed_max}, {kink_max}");
        });
    }

    #[test]
    fn time_that_does_not_pass_changes_nothing() {
        with_voice(1, |voice| {
            begin(voice, 3);
            for _ in 0..30 {
                voice.advance(TICK_US, ONE);
            }
            let before = voice.pose().clone();
            assert_eq!(*voice.advance(0, ONE), before);
        });
    }

    #[test]
    fn any_pause_is_survived() {
        with_voice(1, |voice| {
            for elapsed_us in [u32::MAX, 0, 1, 10_000_000, u32::MAX] {
                begin(voice, 3);
                for _ in 0..4 {
                    voice.advance(elapsed_us, u16::MAX);
                }
            }
        });
    }
}
