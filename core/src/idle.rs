//! What keeps a character alive between commands: now and then a motion, and rest.
//!
//! In:  the length of the last motion, time, the dial of stillness.
//! Out: whether to move now, and how.
//!
//! Why here: constant sway reads as machinery; what reads as life is mostly stillness, then a glance. Everything is
//! drawn anew from a generator that does not repeat within 2^64 numbers, so an hour of idling holds no loop.

use crate::dials::Dials;
use crate::intent::Intent;
use crate::model::{ActionId, Model};
use crate::random::{Pcg32, below};

/// Idle actions and the rest between them.
#[derive(Clone, Debug)]
pub(crate) struct Idle {
    /// Bit i: action i is one of them; none: no idling.
    actions: u64,
    random: Pcg32,
    /// Rest before the next motion, µs.
    rest_us: u32,
}

/// Rest before the first motion, µs.
const FIRST_REST_US: u32 = 500_000;
/// No rest is longer than ten minutes, µs.
const REST_US_MAX: u32 = 600_000_000;

impl Idle {
    pub const fn new(seed: u64) -> Self {
        Self { actions: 0, random: Pcg32::new(seed), rest_us: FIRST_REST_US }
    }

    pub fn set_actions(&mut self, actions: impl IntoIterator<Item = ActionId>) {
        let bits =
            actions.into_iter().map(|action| 1u64.checked_shl(u32::from(action.0)).unwrap_or(0));
        self.actions = bits.fold(0, |set, bit| set | bit);
        self.rest_us = FIRST_REST_US;
    }

    pub fn stop(&mut self) {
        self.actions = 0;
    }

    /// Chooses the rest after a motion of `motion_us`, so that in the long run `stillness_q12` of the time is rest:
    /// on average the motion's length · s / (1 − s), evenly from a quarter to seven quarters of it.
    pub fn rest_after(&mut self, motion_us: u32, stillness_q12: u16) {
        let moving_q12 = u64::from(Dials::ONE_Q12 - stillness_q12.min(Dials::ONE_Q12)).max(1);
        let mean_us = u64::from(motion_us) * u64::from(stillness_q12) / moving_q12;
        let share_q16 = u64::from((1 << 14) + below(3 << 15, &mut || self.random.next_u32()));
        let rest_us = (mean_us.min(u64::from(REST_US_MAX)) * share_q16) >> 16;
        self.rest_us = rest_us.min(u64::from(REST_US_MAX)) as u32;
    }

    /// Lets a resting body wait; the motion that it begins when its rest is over, and how.
    pub fn wait(
        &mut self,
        elapsed_us: u32,
        dials: Dials,
        model: &Model<'_>,
    ) -> Option<(Intent, Dials)> {
        if self.actions == 0 || dials.stillness_q12 >= Dials::ONE_Q12 {
            return None;
        }
        self.rest_us = self.rest_us.saturating_sub(elapsed_us);
        if self.rest_us > 0 { None } else { Some((self.draw(model), self.mood(dials))) }
    }

    /// The dials, each a little off: nobody does the same thing with the same force and haste twice. Intensity and
    /// rate by up to a fifth and a sixth either way, variety three quarters of a turn up, evenly.
    fn mood(&mut self, dials: Dials) -> Dials {
        let mut about = |dial_q12: u16, reach_q12: u32| {
            let factor_q12 = u32::from(Dials::ONE_Q12) - reach_q12
                + below(2 * reach_q12 + 1, &mut || self.random.next_u32());
            ((u32::from(dial_q12) * factor_q12) >> 12) as u16
        };
        let mood = Dials {
            intensity_q12: about(dials.intensity_q12, 819),
            rate_q12: about(dials.rate_q12, 683),
            variety_q12: dials.variety_q12.saturating_add(Dials::ONE_Q12 * 3 / 4),
            ..dials
        };
        mood.clamped()
    }

    /// One of the actions, as long as one that was trained: every action and every frame with equal chance.
    fn draw(&mut self, model: &Model<'_>) -> Intent {
        let mut random = || self.random.next_u32();
        let chosen = below(self.actions.count_ones(), &mut random);
        let mut actions = self.actions;
        for _ in 0..chosen {
            actions &= actions.wrapping_sub(1);
        }
        let action = ActionId(actions.trailing_zeros() as u16);
        let trained = model.trained_frames(action);
        let span = trained.end().saturating_sub(*trained.start()).saturating_add(1);
        let frames = trained.start().saturating_add(below(span, &mut random));
        let rate = u64::from(model.rate_millihz().max(1));
        let duration_ms = (u64::from(frames) * 1_000_000 + rate / 2) / rate;
        let seed = u64::from(random()) << 32 | u64::from(random());
        Intent::new(action, duration_ms as u32, seed).over_ms(600)
    }
}

#[cfg(test)]
mod tests {
    use super::Idle;
    use crate::manifest::SamplerKind;
    use crate::specimen::specimen;
    use crate::{ActionId, Dials, Model, NumberFormat};

    #[test]
    fn rest_is_on_average_what_the_dial_says() {
        for (stillness_q12, expected) in [(0, 0.0), (1024, 1.0 / 3.0), (2048, 1.0), (3277, 4.0)] {
            let mut idle = Idle::new(3);
            let (mut sum, count) = (0.0, 20_000);
            for _ in 0..count {
                idle.rest_after(2_000_000, stillness_q12);
                sum += f64::from(idle.rest_us);
            }
            let mean = sum / f64::from(count) / 2e6;
            assert!((mean - expected).abs() <= 0.02 * expected, "{mean}, expected {expected}");
        }
    }

    #[test]
    fn body_that_shall_be_still_never_moves() {
        let blob = specimen(NumberFormat::W8A16, SamplerKind::ClipCodes);
        let model = Model::from_bytes(&blob).unwrap();
        let mut idle = Idle::new(1);
        idle.set_actions([ActionId(0)]);
        let still = Dials { stillness_q12: 4096, ..Dials::NEUTRAL };
        assert_eq!(idle.wait(u32::MAX, still, &model), None);
        assert!(idle.wait(u32::MAX, Dials::NEUTRAL, &model).is_some());
    }

    #[test]
    fn mood_stays_near_the_dials() {
        let mut idle = Idle::new(1);
        let (mut rates, mut intensities) = ([u16::MAX, 0], [u16::MAX, 0]);
        for _ in 0..10_000 {
            let mood = idle.mood(Dials::NEUTRAL);
            rates = [rates[0].min(mood.rate_q12), rates[1].max(mood.rate_q12)];
            intensities =
                [intensities[0].min(mood.intensity_q12), intensities[1].max(mood.intensity_q12)];
            assert_eq!((mood.stillness_q12, mood.variety_q12), (2731, 7168));
        }
        assert_eq!((rates, intensities), ([3413, 4779], [3277, 4915]));
    }

    #[test]
    fn every_idle_action_and_length_is_drawn_and_can_be_played() {
        let blob = specimen(
            NumberFormat::W8A16,
            SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 },
        );
        let model = Model::from_bytes(&blob).unwrap();
        let mut idle = Idle::new(1);
        idle.set_actions([ActionId(1), ActionId(0), ActionId(200)]);
        let (mut seen, mut frames_min, mut frames_max) = ([0; 2], u32::MAX, 0);
        for _ in 0..1000 {
            let intent = idle.draw(&model);
            seen[usize::from(intent.action.0)] += 1;
            let frames = intent.frames(model.rate_millihz());
            model.check_request(intent.action, frames).unwrap();
            if intent.action == ActionId(0) {
                (frames_min, frames_max) = (frames_min.min(frames), frames_max.max(frames));
            }
        }
        assert!(seen.iter().all(|count| *count > 400), "{seen:?}");
        assert_eq!(frames_min..=frames_max, model.trained_frames(ActionId(0)));
    }
}
