//! What a living thing does whatever else it does: breathe, blink, glance.
//!
//! In:  a score that already holds its action.
//! Out: the same score with signs of life on top, all over before the clip ends.

use super::actor::Actor;
use super::joint::Joint;
use super::score::Score;

/// Breathes until `end_s`: a breath in, a longer breath out, a pause. Breaths that would not end in
/// time are not begun.
pub fn breathe(score: &mut Score, actor: &mut Actor, end_s: f64, depth_deg: f64) {
    let mut now_s = actor.dice.between(0.0, 0.7);
    loop {
        let inhale_s = actor.dice.between(0.8, 1.2) / actor.energy;
        let exhale_s = actor.dice.between(1.1, 1.7) / actor.energy;
        if now_s + inhale_s + exhale_s > end_s {
            return;
        }
        let depth_deg = depth_deg * actor.dice.about_one(0.3);
        let parts = [
            (Joint::BodyLean, -0.8),
            (Joint::NeckPitch, 0.5),
            (Joint::ArmLeft, 1.5),
            (Joint::ArmRight, 1.5),
        ];
        for (joint, share) in parts {
            let part_deg = share * depth_deg;
            let full_s = score.stroke(joint, now_s, inhale_s, part_deg);
            score.stroke(joint, full_s, exhale_s, -part_deg);
        }
        now_s += inhale_s + exhale_s + actor.dice.between(0.15, 0.7);
    }
}

/// Blinks now and then until `end_s`, away from the blinks of the action; some blinks are double.
pub fn blink_now_and_then(score: &mut Score, actor: &mut Actor, end_s: f64) {
    const LONGEST_BLINK_S: f64 = 0.32;
    const AWAY_S: f64 = 1.0;
    let mut now_s = actor.dice.between(0.2, 2.2);
    while now_s + LONGEST_BLINK_S < end_s {
        if score.is_blink_free(now_s - AWAY_S, now_s + AWAY_S) {
            actor.blink(score, now_s);
            let again_s = now_s + LONGEST_BLINK_S + 0.06;
            if actor.dice.chance(0.12) && again_s + LONGEST_BLINK_S < end_s {
                actor.blink(score, again_s);
            }
        }
        now_s += actor.dice.between(1.4, 3.6);
    }
}

/// Looks somewhere else for no reason: the head jumps a few degrees and stays. Returns when it is
/// there.
pub fn glance(score: &mut Score, actor: &mut Actor, start_s: f64, size_deg: f64) -> f64 {
    let yaw_deg = score.offset_deg(Joint::NeckYaw) + actor.dice.side() * actor.size(size_deg);
    let pitch_deg = actor.dice.between(-0.5, 0.5) * size_deg;
    let duration_s = actor.dice.between(0.13, 0.22);
    score.key(Joint::NeckPitch, start_s, duration_s, pitch_deg);
    score.key(Joint::NeckYaw, start_s, duration_s, yaw_deg)
}
