//! What overcomes the character.

use crate::character::actor::Actor;
use crate::character::joint::Joint::{
    ArmLeft, ArmRight, BodyLean, BodyYaw, Brow, Eyelid, Jaw, NeckPitch, NeckRoll, Whisk,
};
use crate::character::score::Score;

/// Jumps away from a bang with wide eyes, freezes, lets go with a double blink, and sometimes
/// shakes it off.
pub fn startle(score: &mut Score, actor: &mut Actor) {
    let bang_s = actor.dice.between(0.15, 0.5);
    let shock = actor.dice.between(0.6, 1.3);
    let from_side = actor.side * actor.dice.between(0.0, 1.0);
    let far_share = actor.dice.between(0.2, 1.0);
    actor.blink(score, bang_s - 0.06);
    score.key(BodyLean, bang_s, actor.beat(0.15), -shock * actor.size(11.0));
    score.key(BodyYaw, bang_s, actor.beat(0.22), -from_side * actor.size(20.0));
    score.key(NeckPitch, bang_s + 0.02, actor.beat(0.14), -shock * actor.size(15.0));
    score.key(NeckRoll, bang_s, actor.beat(0.2), actor.side * actor.size(5.0));
    score.key(Brow, bang_s, actor.beat(0.12), actor.size(13.0));
    score.key(Eyelid, bang_s + 0.03, actor.beat(0.12), -actor.size(5.0));
    score.key(Jaw, bang_s + 0.05, actor.beat(0.14), shock * actor.size(13.0));
    let raised_deg = shock * actor.size(44.0);
    score.key(actor.near_arm(), bang_s + 0.01, actor.beat(0.2), raised_deg);
    score.key(actor.far_arm(), bang_s + 0.05, actor.beat(0.2), far_share * raised_deg);
    let frozen_s = score.key(Whisk, bang_s + 0.06, actor.beat(0.2), -actor.size(12.0));
    actor.turn_head(score, bang_s + 0.12, 0.18, from_side * 38.0);

    let now_s = frozen_s + actor.dice.between(0.2, 0.6 + 0.5 * shock);
    let again_s = now_s + actor.dice.between(0.26, 0.36);
    actor.blink(score, now_s - 0.1);
    actor.blink(score, again_s);
    let calm_s = calm_down(score, actor, now_s);
    actor.go_home(score, calm_s, 0.45);
}

/// The body sinks past its rest pose; one actor in three shakes its head at itself.
fn calm_down(score: &mut Score, actor: &mut Actor, start_s: f64) -> f64 {
    score.key(Jaw, start_s, actor.beat(0.3), 0.0);
    score.key(Eyelid, start_s, actor.beat(0.35), 2.0);
    score.key(Brow, start_s + 0.1, actor.beat(0.4), -actor.size(3.0));
    score.key(BodyLean, start_s + 0.05, actor.beat(0.6), actor.size(5.0));
    score.key(ArmLeft, start_s + 0.1, actor.beat(0.5), -actor.size(7.0));
    score.key(ArmRight, start_s + 0.14, actor.beat(0.55), -actor.size(7.0));
    score.key(Whisk, start_s + 0.1, actor.beat(0.4), 0.0);
    let sunk_s = score.key(NeckPitch, start_s + 0.08, actor.beat(0.5), actor.size(6.0));
    if !actor.dice.chance(0.35) {
        return sunk_s;
    }
    let shrug_deg = actor.side * actor.size(12.0);
    let left_s = actor.turn_head(score, sunk_s - 0.1, 0.17, shrug_deg);
    actor.turn_head(score, left_s, 0.2, -0.7 * shrug_deg)
}

/// Laughs: draws breath, throws its head back or doubles over, shakes with every "ha" until they
/// run out, and sighs.
pub fn laugh(score: &mut Score, actor: &mut Actor) {
    let start_s = actor.beat(0.12);
    let back = if actor.dice.chance(0.65) { -1.0 } else { 1.0 };
    score.key(BodyLean, start_s, actor.beat(0.28), -back * actor.size(4.0));
    score.key(NeckPitch, start_s, actor.beat(0.26), -back * actor.size(5.0));
    let drawn_s = score.key(Brow, start_s, actor.beat(0.22), actor.size(7.0));

    let sway_deg = actor.side * actor.size(9.0);
    score.key(BodyLean, drawn_s, actor.beat(0.35), back * actor.size(9.0));
    score.key(NeckPitch, drawn_s + 0.04, actor.beat(0.35), back * actor.size(15.0));
    score.key(NeckRoll, drawn_s + 0.05, actor.beat(0.6), sway_deg);
    score.key(BodyYaw, drawn_s, actor.beat(0.9), sway_deg);
    score.key(Eyelid, drawn_s + 0.03, actor.beat(0.2), actor.size(13.0));
    let spent_s = run_of_has(score, actor, drawn_s);

    let sunk_s = score.key(BodyLean, spent_s, actor.beat(0.5), actor.size(4.0));
    score.key(NeckPitch, spent_s + 0.06, actor.beat(0.5), actor.size(5.0));
    score.key(NeckRoll, spent_s, actor.beat(0.5), -0.6 * sway_deg);
    score.key(BodyYaw, spent_s + 0.1, actor.beat(0.6), -0.4 * sway_deg);
    score.key(Eyelid, spent_s + 0.1, actor.beat(0.3), 1.0);
    score.bump(Jaw, spent_s + 0.15, actor.beat(0.6), actor.size(6.0));
    actor.blink(score, sunk_s + 0.05);
    actor.go_home(score, sunk_s, 0.6);
}

/// One jolt a "ha", in one or two bursts with a gasp between; jaw, belly, head and arms follow each
/// other.
fn run_of_has(score: &mut Score, actor: &mut Actor, start_s: f64) -> f64 {
    let ha_s = actor.dice.between(0.18, 0.25);
    let ha_count = actor.dice.count(3, 9);
    let gasp_after = actor.dice.count(3, 9);
    let jaw_share = actor.dice.between(0.7, 1.3);
    let mut strength = 1.0;
    let mut now_s = start_s;
    for ha in 1..=ha_count {
        let beat_s = ha_s * actor.dice.about_one(0.15);
        score.bump(Jaw, now_s, 1.1 * beat_s, jaw_share * strength * actor.size(15.0));
        score.bump(BodyLean, now_s + 0.04, beat_s, strength * actor.size(4.5));
        score.bump(NeckPitch, now_s + 0.07, beat_s, strength * actor.size(4.0));
        score.bump(ArmLeft, now_s + 0.05, beat_s, strength * actor.size(15.0));
        score.bump(ArmRight, now_s + 0.08, beat_s, strength * actor.size(15.0));
        strength *= actor.dice.between(0.82, 0.97);
        now_s += beat_s;
        if ha == gasp_after {
            score.bump(BodyLean, now_s, actor.beat(0.4), -actor.size(4.0));
            now_s += actor.beat(0.3);
            strength = 1.0;
        }
    }
    now_s
}

/// Nods off in two or three stages, each deeper and only half caught; wakes with a start or slowly,
/// and blinks.
pub fn doze(score: &mut Score, actor: &mut Actor) {
    let mut now_s = actor.dice.between(0.1, 0.4);
    let stage_count = actor.dice.count(1, 3);
    let depth_deg = actor.size(24.0);
    let roll_deg = actor.side * actor.size(10.0);
    for stage in 1..=stage_count {
        let share = f64::from(stage) / f64::from(stage_count);
        let sink_s = actor.beat(1.1 / f64::from(stage_count) + 0.35);
        now_s = sink(score, now_s, sink_s, share, depth_deg);
        score.key(NeckRoll, now_s - 0.6 * sink_s, sink_s, share * roll_deg);
        score.key(BodyYaw, now_s - 0.7 * sink_s, sink_s, share * 0.6 * roll_deg);
        now_s += actor.dice.between(0.0, 0.15);
        if stage < stage_count {
            let caught_deg = (share - 0.3) * depth_deg;
            score.key(Eyelid, now_s, actor.beat(0.2), 10.0 * share);
            now_s = score.key(NeckPitch, now_s, actor.beat(0.18), caught_deg);
        }
    }

    let wake_s = now_s + actor.dice.between(0.25, 0.6);
    let fright = if actor.dice.chance(0.6) { 1.0 } else { 0.25 };
    let lift_s = 0.13 + 0.35 * (1.0 - fright);
    score.key(NeckPitch, wake_s, actor.beat(lift_s + 0.04), -fright * actor.size(8.0));
    score.key(NeckRoll, wake_s + 0.02, actor.beat(lift_s + 0.1), -fright * 0.4 * roll_deg);
    score.key(BodyLean, wake_s + 0.03, actor.beat(lift_s + 0.15), -fright * actor.size(4.0));
    score.key(Eyelid, wake_s, actor.beat(lift_s), -2.0);
    let awake_s = score.key(Brow, wake_s, actor.beat(lift_s + 0.02), fright * actor.size(10.0));
    let again_s = awake_s + actor.dice.between(0.45, 0.55);
    actor.blink(score, awake_s + 0.1);
    actor.blink(score, again_s);
    actor.go_home(score, awake_s + 0.15, 0.5);
}

/// Lids first, then the head, and last the body and the arms; returns when the head is down.
fn sink(score: &mut Score, start_s: f64, sink_s: f64, share: f64, depth_deg: f64) -> f64 {
    score.key(Eyelid, start_s, 0.7 * sink_s, 4.0 + 15.0 * share);
    score.key(Brow, start_s, sink_s, -6.0 * share);
    score.key(BodyLean, start_s + 0.3, sink_s, share * 0.35 * depth_deg);
    score.key(Jaw, start_s + 0.35, sink_s, 5.0 * share);
    score.key(ArmLeft, start_s + 0.3, sink_s, -11.0 * share);
    score.key(ArmRight, start_s + 0.2, sink_s, -11.0 * share);
    score.key(Whisk, start_s + 0.2, sink_s, 9.0 * share);
    score.key(NeckPitch, start_s + 0.15, sink_s, share * depth_deg)
}
