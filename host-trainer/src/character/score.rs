//! The score of one clip: which joint wants to be where, when.
//!
//! In:  gestures of an action (`actions/*.rs`) and of plain being alive (`life.rs`).
//! Out: the goal of every joint at any time, to `follow_through.rs`.

use super::joint::{JOINT_COUNT, Joint};
use super::keyframe::{Stroke, Track, minimum_jerk};

/// Lid position that counts as shut.
const LID_SHUT_DEG: f64 = 20.0;

/// Share of a servo's top speed that keys may ask for; the rest is for swinging and for strokes
/// that overlap.
const KEYED_SPEED_SHARE: f64 = 0.75;

/// Share of every key that arrives late and slowly, so that a hold does not look like a stop.
const CREEP_SHARE: f64 = 0.08;

/// One blink: lids close fast, stay shut for a moment and open more slowly.
#[derive(Clone, Copy, Debug)]
pub struct Blink {
    /// When the lids begin to close.
    pub start_s: f64,
    /// Closing; about 80 ms in people.
    pub close_s: f64,
    /// Shut.
    pub shut_s: f64,
    /// Opening; about twice as long as closing.
    pub open_s: f64,
}

impl Blink {
    /// When the lids are open again.
    pub fn end_s(&self) -> f64 {
        self.start_s + self.close_s + self.shut_s + self.open_s
    }

    /// 0 open, 1 shut.
    fn closure(&self, time_s: f64) -> f64 {
        let closing = minimum_jerk((time_s - self.start_s) / self.close_s);
        let open_start_s = self.start_s + self.close_s + self.shut_s;
        closing - minimum_jerk((time_s - open_start_s) / self.open_s)
    }
}

/// Goals of all joints over one clip.
#[derive(Clone, Debug)]
pub struct Score {
    tracks: [Track; JOINT_COUNT],
    blinks: Vec<Blink>,
    posture_deg: [f64; JOINT_COUNT],
    attack: f64,
}

impl Score {
    /// An empty score: the posture, held. `attack` shapes every key, see [`Stroke::attack`].
    pub fn new(posture_deg: [f64; JOINT_COUNT], attack: f64) -> Self {
        Self { tracks: Default::default(), blinks: Vec::new(), posture_deg, attack }
    }

    /// Moves a joint to `offset_deg` from the posture; returns when it will be all but there. A key
    /// that asks for more than the servo can do takes longer. It may begin before the joint's last
    /// key has arrived.
    pub fn key(&mut self, joint: Joint, start_s: f64, duration_s: f64, offset_deg: f64) -> f64 {
        let delta_deg = offset_deg - self.offset_deg(joint);
        let creep_deg = CREEP_SHARE * delta_deg;
        let end_s = self.stroke(joint, start_s, duration_s, delta_deg - creep_deg);
        let duration_s = end_s - start_s;
        self.stroke(joint, start_s + 0.4 * duration_s, 1.6 * duration_s, creep_deg);
        end_s
    }

    /// Pushes a joint away by about `peak_deg` and back, on top of whatever else it does; returns
    /// when it is over.
    pub fn bump(&mut self, joint: Joint, start_s: f64, duration_s: f64, peak_deg: f64) -> f64 {
        let turn_s = self.stroke(joint, start_s, 0.6 * duration_s, peak_deg);
        let back_s = start_s + (turn_s - start_s) / 1.5;
        self.stroke(joint, back_s, 0.6 * duration_s, -peak_deg)
    }

    /// Moves a joint by `delta_deg`, on top of whatever else it does; returns when it is over.
    pub fn stroke(&mut self, joint: Joint, start_s: f64, duration_s: f64, delta_deg: f64) -> f64 {
        let speed = KEYED_SPEED_SHARE * joint.spec().speed_deg_per_s_max;
        let shortest_s = Stroke::shortest_s(delta_deg, self.attack, speed);
        let duration_s = duration_s.max(shortest_s);
        self.tracks[joint.index()].add(Stroke {
            start_s,
            duration_s,
            delta_deg,
            attack: self.attack,
        });
        start_s + duration_s
    }

    /// Adds a blink, unless another is too near for lids to tell them apart.
    pub fn blink(&mut self, blink: Blink) {
        const GAP_S: f64 = 0.05;
        if self.is_blink_free(blink.start_s - GAP_S, blink.end_s() + GAP_S) {
            self.blinks.push(blink);
        }
    }

    /// Whether no blink falls into this time.
    pub fn is_blink_free(&self, start_s: f64, end_s: f64) -> bool {
        let outside = |blink: &Blink| blink.end_s() < start_s || end_s < blink.start_s;
        self.blinks.iter().all(outside)
    }

    /// How far from the posture the joint will be when all its keys are done.
    pub fn offset_deg(&self, joint: Joint) -> f64 {
        self.tracks[joint.index()].goal_deg()
    }

    /// When the last key and the last blink are done.
    pub fn end_s(&self) -> f64 {
        let keys = self.tracks.iter().map(Track::end_s);
        keys.chain(self.blinks.iter().map(Blink::end_s)).fold(0.0, f64::max)
    }

    /// Hurries when the score would overrun `seconds`. Blinks come earlier but keep their speed.
    pub fn fit_into(&mut self, seconds: f64) {
        let factor = seconds / self.end_s();
        if factor < 1.0 {
            self.tracks.iter_mut().for_each(|t| t.stretch(factor));
            self.blinks.iter_mut().for_each(|b| b.start_s *= factor);
        }
    }

    /// Where the joint wants to be.
    pub fn goal_deg(&self, joint: Joint, time_s: f64) -> f64 {
        let index = joint.index();
        let keyed_deg = self.posture_deg[index] + self.tracks[index].value_deg(time_s);
        if joint != Joint::Eyelid {
            return keyed_deg;
        }
        let closure = self.blinks.iter().map(|b| b.closure(time_s)).sum::<f64>();
        keyed_deg + closure * (LID_SHUT_DEG - keyed_deg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLINK: Blink = Blink { start_s: 1.0, close_s: 0.08, shut_s: 0.03, open_s: 0.16 };

    fn empty() -> Score {
        Score::new([0.0; JOINT_COUNT], 0.0)
    }

    #[test]
    fn a_key_faster_than_the_servo_takes_longer() {
        let mut score = empty();
        let end_s = score.key(Joint::BodyYaw, 0.0, 0.01, 50.0);
        assert!(end_s > 50.0 / Joint::BodyYaw.spec().speed_deg_per_s_max);
        assert!((46.0..50.0).contains(&score.goal_deg(Joint::BodyYaw, end_s)));
        assert!((score.goal_deg(Joint::BodyYaw, 2.0 * end_s) - 50.0).abs() < 1e-12);
    }

    #[test]
    fn a_blink_on_top_of_another_is_left_out() {
        let mut score = empty();
        score.blink(BLINK);
        let one_s = score.end_s();
        score.blink(Blink { start_s: 1.2, ..BLINK });
        assert_eq!(score.end_s(), one_s);
    }

    #[test]
    fn a_blink_shuts_the_lids_wherever_they_were() {
        for droop_deg in [-4.0, 0.0, 12.0] {
            let mut score = empty();
            score.stroke(Joint::Eyelid, 0.0, 0.3, droop_deg);
            score.blink(BLINK);
            assert_eq!(score.goal_deg(Joint::Eyelid, 0.9), droop_deg);
            assert_eq!(score.goal_deg(Joint::Eyelid, 1.09), LID_SHUT_DEG);
            assert_eq!(score.goal_deg(Joint::Eyelid, 1.3), droop_deg);
        }
    }

    #[test]
    fn a_score_that_overruns_hurries_and_one_in_time_does_not() {
        let mut score = empty();
        score.key(Joint::Brow, 1.0, 3.0, 5.0);
        let end_s = score.end_s();
        score.fit_into(end_s + 1.0);
        assert_eq!(score.end_s(), end_s);
        score.fit_into(2.0);
        assert!((score.end_s() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_bump_comes_back_to_the_key_below_it() {
        let mut score = empty();
        score.stroke(Joint::Jaw, 0.0, 0.2, 4.0);
        let end_s = score.bump(Joint::Jaw, 0.3, 0.2, 10.0);
        assert!(score.goal_deg(Joint::Jaw, 0.4) > 12.0);
        assert!((score.goal_deg(Joint::Jaw, end_s) - 4.0).abs() < 1e-12);
        assert!((score.offset_deg(Joint::Jaw) - 4.0).abs() < 1e-12);
    }
}
