//! Who plays: the temperament of one clip and all its variation.
//!
//! In:  [`Dice`] of the clip.
//! Out: durations and sizes to `actions/*.rs`, an empty [`Score`] in this actor's posture.
//!
//! Why here: energy and mood are drawn once a clip and colour every gesture of it. Independent
//! jitter on each key would look nervous; one temperament through a whole clip looks like
//! character.

use super::dice::Dice;
use super::joint::Joint;
use super::score::{Blink, Score};

/// Temperament of one clip.
#[derive(Clone, Debug)]
pub struct Actor {
    /// Draws for what varies within the clip.
    pub dice: Dice,
    /// 0.65 slow and small … 1.4 quick and large.
    pub energy: f64,
    /// −1 gloomy … 1 cheerful.
    pub mood: f64,
    /// The preferred side, −1 right or 1 left, as the sign of the yaw joints.
    pub side: f64,
}

impl Actor {
    /// Draws a temperament.
    pub fn new(mut dice: Dice) -> Self {
        Self {
            energy: dice.between(0.65, 1.4),
            mood: dice.between(-1.0, 1.0),
            side: dice.side(),
            dice,
        }
    }

    /// A duration in this actor's tempo, around `seconds`.
    pub fn beat(&mut self, seconds: f64) -> f64 {
        seconds * self.dice.about_one(0.3) / (0.4 + 0.6 * self.energy)
    }

    /// An amplitude of this actor, around `degrees`.
    pub fn size(&mut self, degrees: f64) -> f64 {
        degrees * self.dice.about_one(0.35) * (0.35 + 0.65 * self.energy)
    }

    /// The arm on the preferred side.
    pub fn near_arm(&self) -> Joint {
        if self.side > 0.0 { Joint::ArmLeft } else { Joint::ArmRight }
    }

    /// The other arm.
    pub fn far_arm(&self) -> Joint {
        if self.side > 0.0 { Joint::ArmRight } else { Joint::ArmLeft }
    }

    /// An empty score in this actor's way of standing: never quite the same rest pose.
    pub fn empty_score(&mut self) -> Score {
        let posture_deg = Joint::ALL.map(|joint| {
            let drawn_deg = match joint {
                Joint::Eyelid => self.dice.between(0.0, 2.5) - self.mood,
                Joint::Brow => 3.0 * self.mood,
                Joint::Jaw => 0.0,
                Joint::BodyLean | Joint::NeckPitch => {
                    self.dice.between(-1.5, 1.5) - 1.5 * self.mood
                }
                Joint::ArmLeft | Joint::ArmRight => self.dice.between(-2.5, 2.5),
                _ => self.dice.between(-2.0, 2.0),
            };
            joint.spec().rest_deg + drawn_deg
        });
        Score::new(posture_deg, 0.45 * self.energy)
    }

    /// Blinks.
    pub fn blink(&mut self, score: &mut Score, start_s: f64) {
        score.blink(Blink {
            start_s,
            close_s: self.dice.between(0.07, 0.09),
            shut_s: self.dice.between(0.0, 0.03),
            open_s: self.dice.between(0.14, 0.20),
        });
    }

    /// Turns the head to `yaw_deg` from the posture in around `seconds`; returns when it is there.
    /// It goes by way of an arc, dipping a little, and large turns bring a blink.
    pub fn turn_head(
        &mut self,
        score: &mut Score,
        start_s: f64,
        seconds: f64,
        yaw_deg: f64,
    ) -> f64 {
        let duration_s = self.beat(seconds);
        let delta_deg = yaw_deg - score.offset_deg(Joint::NeckYaw);
        let end_s = score.key(Joint::NeckYaw, start_s, duration_s, yaw_deg);
        let dip_deg = 0.12 * delta_deg.abs() * self.dice.between(0.6, 1.2);
        score.bump(Joint::NeckPitch, start_s, end_s - start_s, dip_deg);
        let is_large = delta_deg.abs() > 18.0 && score.is_blink_free(start_s - 0.8, end_s + 0.8);
        if is_large && self.dice.chance(0.6) {
            self.blink(score, start_s);
        }
        end_s
    }

    /// Brings every joint back to the posture in around `seconds`, none quite together with
    /// another.
    pub fn go_home(&mut self, score: &mut Score, start_s: f64, seconds: f64) {
        let duration_s = self.beat(seconds);
        for joint in Joint::ALL {
            if score.offset_deg(joint).abs() > 1e-9 {
                let joint_start_s = start_s + self.dice.between(0.0, 0.3) * duration_s;
                let joint_duration_s = self.dice.between(0.75, 1.1) * duration_s;
                score.key(joint, joint_start_s, joint_duration_s, 0.0);
            }
        }
    }
}
