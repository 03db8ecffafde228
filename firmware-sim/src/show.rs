//! The performance that is given when no script is: a working day of a character, made from a seed.
//!
//! In:  the model, how long, a seed.
//! Out: [`Cue`]s in order of time.
//!
//! Why here: limits must hold not only in a calm hour. Mostly the character idles; every quarter to three quarters of a
//! minute somebody wants something of it, interrupts it, or something breaks.

use karakuri::{ActionId, Dials, Model, Pcg32};

use crate::cue::{Cue, Deed};

/// Milliseconds between two things that somebody wants: least and most.
const PAUSE_MS: [u32; 2] = [15_000, 45_000];

struct Show<'a, 'm> {
    model: &'a Model<'m>,
    random: Pcg32,
    tick_hz: u32,
    cues: Vec<Cue>,
}

/// The cues of `minutes`.
pub fn show(model: &Model<'_>, minutes: f64, tick_hz: u32, seed: u64) -> Vec<Cue> {
    let mut show = Show { model, random: Pcg32::new(seed), tick_hz, cues: Vec::new() };
    show.begin(0);
    let end_ms = (minutes * 60_000.0).min(4e9) as u32;
    let mut now_ms = 5_000 + show.below(5_000);
    while now_ms < end_ms {
        show.happen(now_ms);
        now_ms += PAUSE_MS[0] + show.below(PAUSE_MS[1] - PAUSE_MS[0]);
    }
    show.cues.sort_by_key(|cue| cue.tick);
    show.cues
}

impl Show<'_, '_> {
    fn below(&mut self, count: u32) -> u32 {
        ((u64::from(self.random.next_u32()) * u64::from(count)) >> 32) as u32
    }

    fn cue(&mut self, at_ms: u32, deed: Deed) {
        let tick = (u64::from(at_ms) * u64::from(self.tick_hz)).div_ceil(1000) as u32;
        self.cues.push(Cue { tick, deed });
    }

    /// A character that has just got power.
    fn begin(&mut self, at_ms: u32) {
        self.cue(at_ms, Deed::Wake);
        self.idle(at_ms + 1000);
    }

    fn idle(&mut self, at_ms: u32) {
        let count = self.model.actions().count().min(64) as u32;
        self.cue(at_ms, Deed::Idle { actions: u64::MAX.unbounded_shr(64 - count) });
    }

    fn happen(&mut self, at_ms: u32) {
        match self.below(32) {
            0..=9 => self.play(at_ms),
            10..=13 => self.interrupt(at_ms),
            14..=16 => self.queue(at_ms),
            17..=20 => self.turn_dials(at_ms),
            21..=22 => {
                self.cue(at_ms, Deed::Hold);
                let until_ms = at_ms + 1000 + self.below(4000);
                self.cue(until_ms, Deed::Resume);
            }
            23..=24 => {
                self.cue(at_ms, Deed::SoftStop);
                self.idle(at_ms + 3000);
            }
            25 => {
                self.cue(at_ms, Deed::Relax);
                self.begin(at_ms + 2000);
            }
            26..=28 => {
                let by_us = 1000 + self.below(120_000);
                self.cue(at_ms, Deed::Late { by_us });
            }
            29 => {
                self.cue(at_ms, Deed::Late { by_us: 400_000 });
                self.cue(at_ms + 2000, Deed::ClearFault);
            }
            30 => {
                let ticks = 1 + self.below(10);
                self.cue(at_ms, Deed::Lose { ticks });
            }
            _ => {
                self.cue(at_ms, Deed::BrownOut);
                self.begin(at_ms + 1000);
            }
        }
    }

    fn motion(&mut self) -> (u16, u32, u32) {
        let action = self.below(self.model.actions().count() as u32) as u16;
        let trained = self.model.trained_frames(ActionId(action));
        let mut frames = *trained.start();
        for _ in 0..8 {
            let drawn = trained.start() + self.below(trained.end() - trained.start() + 1);
            if self.model.check_request(ActionId(action), drawn).is_ok() {
                frames = drawn;
                break;
            }
        }
        let rate = u64::from(self.model.rate_millihz().max(1));
        let duration_ms = (u64::from(frames) * 1_000_000 + rate / 2) / rate;
        (action, duration_ms as u32, self.random.next_u32())
    }

    fn play(&mut self, at_ms: u32) {
        let (action, duration_ms, seed) = self.motion();
        let transition_ms = 100 + self.below(700) as u16;
        self.cue(at_ms, Deed::Play { action, duration_ms, seed, transition_ms });
    }

    /// Somebody cannot make up his mind.
    fn interrupt(&mut self, at_ms: u32) {
        let mut now_ms = at_ms;
        for _ in 0..5 {
            self.play(now_ms);
            now_ms += 20 + self.below(600);
        }
    }

    fn queue(&mut self, at_ms: u32) {
        for _ in 0..2 {
            let (action, duration_ms, seed) = self.motion();
            self.cue(at_ms, Deed::Then { action, duration_ms, seed, transition_ms: 400 });
        }
    }

    fn turn_dials(&mut self, at_ms: u32) {
        let deed = Deed::Dials(Dials {
            intensity_q12: 2048 + self.below(4096) as u16,
            rate_q12: 2048 + self.below(4096) as u16,
            stillness_q12: 1024 + self.below(2560) as u16,
            variety_q12: 2048 + self.below(6144) as u16,
        });
        self.cue(at_ms, deed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    #[test]
    fn hour_has_everything_in_it_and_follows_from_its_seed() {
        let blob = Fixture::new(1).blob(NumberFormat::W8A16);
        let model = Model::from_bytes(&blob).unwrap();
        let cues = show(&model, 600.0, 50, 1);
        assert_eq!(cues, show(&model, 600.0, 50, 1));
        assert_ne!(cues, show(&model, 600.0, 50, 2));
        assert!(cues.is_sorted_by_key(|cue| cue.tick));
        let mut kinds: Vec<_> = cues
            .iter()
            .map(|cue| u16::from_le_bytes([cue.to_bytes()[4], cue.to_bytes()[5]]))
            .collect();
        kinds.sort_unstable();
        kinds.dedup();
        // All but the breath.
        assert_eq!(kinds, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13]);
    }
}
