//! Where the character's mind is.

use crate::character::actor::Actor;
use crate::character::joint::Joint::{
    ArmLeft, ArmRight, BodyLean, BodyYaw, Brow, Eyelid, NeckPitch, NeckRoll, NeckYaw, Whisk,
};
use crate::character::life;
use crate::character::score::Score;

/// Waits: shifts its weight, glances about, looks into its tray, shrugs its arms loose, and holds
/// still in between.
pub fn idle(score: &mut Score, actor: &mut Actor) {
    let mut now_s = actor.dice.between(0.2, 0.8);
    let enough_s = actor.dice.between(1.5, 3.2);
    while now_s < enough_s {
        let arrived_s = match actor.dice.count(0, 4) {
            0 | 1 => shift_weight(score, actor, now_s),
            2 => loosen_arms(score, actor, now_s),
            3 => {
                score.key(Eyelid, now_s, actor.beat(0.3), actor.size(5.0));
                score.key(NeckPitch, now_s, actor.beat(0.45), actor.size(11.0))
            }
            _ => life::glance(score, actor, now_s, 14.0),
        };
        if actor.dice.chance(0.3) {
            score.bump(Brow, arrived_s, actor.beat(0.45), actor.size(6.0));
            score.bump(Whisk, arrived_s + 0.08, actor.beat(0.4), actor.size(9.0));
        }
        now_s = arrived_s + actor.dice.between(0.25, 0.75);
        if actor.dice.chance(0.4) {
            score.key(Eyelid, now_s, actor.beat(0.25), 0.0);
            now_s = life::glance(score, actor, now_s, 8.0);
            now_s += actor.dice.between(0.2, 0.5);
        }
    }
    actor.go_home(score, now_s, 0.6);
}

fn shift_weight(score: &mut Score, actor: &mut Actor, start_s: f64) -> f64 {
    let to_side = actor.dice.side();
    score.key(NeckYaw, start_s, actor.beat(0.5), -to_side * actor.size(7.0));
    score.key(NeckRoll, start_s + 0.15, actor.beat(0.7), to_side * actor.size(6.0));
    score.bump(BodyLean, start_s, actor.beat(0.9), actor.size(3.5));
    score.key(BodyYaw, start_s + 0.08, actor.beat(0.75), to_side * actor.size(12.0))
}

fn loosen_arms(score: &mut Score, actor: &mut Actor, start_s: f64) -> f64 {
    let (first, second) = (actor.near_arm(), actor.far_arm());
    score.bump(BodyLean, start_s, actor.beat(0.8), -actor.size(4.0));
    score.bump(second, start_s + actor.beat(0.12), actor.beat(0.6), actor.size(9.0));
    score.bump(first, start_s, actor.beat(0.6), actor.size(13.0))
}

/// Looks to two to four places: the head leads, the body follows and gives the head some of its
/// turn back. Sometimes it leans forward to see better.
pub fn look_around(score: &mut Score, actor: &mut Actor) {
    let mut to_side = actor.side;
    let start_s = actor.beat(0.2);
    score.key(NeckYaw, start_s, actor.beat(0.16), -to_side * actor.size(4.0));
    let mut now_s = start_s + 0.13;
    for _ in 0..actor.dice.count(2, 3) {
        let gaze_deg = to_side * actor.size(46.0);
        let body_deg = gaze_deg * actor.dice.between(0.3, 0.55);
        let pitch_deg = actor.dice.between(-16.0, 13.0);
        let there_s = actor.turn_head(score, now_s, 0.32, 0.85 * gaze_deg);
        score.key(NeckPitch, now_s + 0.05, actor.beat(0.36), pitch_deg);
        score.key(BodyYaw, now_s + actor.beat(0.12), actor.beat(0.6), body_deg);
        score.key(NeckYaw, there_s, actor.beat(0.4), gaze_deg - body_deg);
        score.key(Brow, there_s - 0.1, actor.beat(0.25), -0.6 * pitch_deg + 3.0 * actor.mood);
        score.key(NeckRoll, now_s + 0.1, actor.beat(0.5), -to_side * actor.size(5.0));
        if actor.dice.chance(0.4) {
            score.key(BodyLean, now_s + 0.2, actor.beat(0.45), actor.size(9.0));
            score.key(Eyelid, there_s, actor.beat(0.2), actor.size(5.0));
        } else {
            score.key(BodyLean, now_s, actor.beat(0.45), -actor.size(1.0));
            score.key(Eyelid, now_s, actor.beat(0.2), -actor.size(2.0));
        }
        now_s = there_s + actor.dice.between(0.2, 0.5);
        if actor.dice.chance(0.6) {
            let yaw_deg = score.offset_deg(NeckYaw) + actor.dice.side() * actor.size(7.0);
            let focus_s = score.key(NeckYaw, now_s, actor.beat(0.16), yaw_deg);
            now_s = focus_s + actor.dice.between(0.2, 0.45);
        }
        if actor.dice.chance(0.8) {
            to_side = -to_side;
        }
    }
    actor.go_home(score, now_s, 0.55);
}

/// Cocks its head at something odd, leans in, brows up, an arm to its chin; often tilts the other
/// way to be sure.
pub fn wonder(score: &mut Score, actor: &mut Actor) {
    let start_s = actor.beat(0.15);
    let mut to_side = actor.side;
    score.key(NeckPitch, start_s, actor.beat(0.22), actor.size(4.0));
    score.key(NeckRoll, start_s, actor.beat(0.2), -to_side * actor.size(4.0));

    let mut now_s = start_s + actor.beat(0.18);
    score.key(BodyLean, now_s + 0.1, actor.beat(0.6), actor.size(8.0));
    score.key(Brow, now_s - 0.05, actor.beat(0.2), actor.size(10.5));
    score.key(Eyelid, now_s, actor.beat(0.2), -actor.size(4.0));
    score.key(Whisk, now_s + 0.1, actor.beat(0.3), actor.size(12.0));
    score.key(NeckPitch, now_s, actor.beat(0.4), -actor.size(7.0));
    score.key(actor.near_arm(), now_s + 0.15, actor.beat(0.45), actor.size(26.0));
    for _ in 0..actor.dice.count(1, 3) {
        let tilt_deg = to_side * actor.size(15.0);
        let yaw_deg = to_side * actor.size(11.0);
        let tilted_s = score.key(NeckRoll, now_s, actor.beat(0.34), tilt_deg);
        actor.turn_head(score, now_s + 0.05, 0.36, yaw_deg);
        score.key(BodyYaw, now_s + 0.2, actor.beat(0.6), 0.5 * yaw_deg);
        now_s = tilted_s + actor.dice.between(0.25, 0.65);
        if actor.dice.chance(0.5) {
            now_s = score.key(NeckRoll, now_s, actor.beat(0.15), 1.35 * tilt_deg);
            score.bump(Brow, now_s - 0.15, actor.beat(0.4), actor.size(5.0));
            score.bump(ArmLeft, now_s - 0.1, actor.beat(0.3), actor.size(5.0));
            score.bump(ArmRight, now_s - 0.06, actor.beat(0.3), actor.size(5.0));
            now_s += actor.dice.between(0.2, 0.45);
        }
        to_side = -to_side;
    }
    actor.go_home(score, now_s, 0.55);
}
