//! What a good host does.

use crate::character::actor::Actor;
use crate::character::joint::Joint::{
    ArmLeft, ArmRight, BodyLean, BodyYaw, Brow, Eyelid, Jaw, NeckPitch, NeckRoll, Whisk,
};
use crate::character::score::Score;

/// Bows to a guest once or twice: draws itself up, folds from the waist with the head behind,
/// stays, rises. The cheerful wave.
pub fn greet(score: &mut Score, actor: &mut Actor) {
    let start_s = actor.beat(0.12);
    let guest_deg = actor.side * actor.dice.between(0.0, 28.0);
    actor.turn_head(score, start_s, 0.25, 0.6 * guest_deg);
    score.key(BodyYaw, start_s + 0.1, actor.beat(0.5), 0.4 * guest_deg);
    score.key(NeckPitch, start_s + 0.08, actor.beat(0.25), -actor.size(6.0));
    score.key(Brow, start_s, actor.beat(0.2), actor.size(8.0));
    let drawn_up_s = score.key(BodyLean, start_s + 0.05, actor.beat(0.28), -actor.size(4.0));

    let depth_deg = actor.size(19.0);
    let mut now_s = bow(score, actor, drawn_up_s - 0.05, depth_deg);
    if actor.dice.chance(0.25) {
        now_s = bow(score, actor, now_s - 0.1, 0.55 * depth_deg);
    }
    if actor.mood > 0.1 {
        now_s = wave(score, actor, now_s - 0.15);
    }
    actor.go_home(score, now_s, 0.45);
}

fn bow(score: &mut Score, actor: &mut Actor, start_s: f64, depth_deg: f64) -> f64 {
    let bowed_s = score.key(BodyLean, start_s, actor.beat(0.45), depth_deg);
    score.key(NeckPitch, start_s + 0.1, actor.beat(0.45), depth_deg * actor.dice.between(0.6, 1.1));
    score.key(Eyelid, start_s + 0.05, actor.beat(0.4), 0.55 * depth_deg);
    score.key(ArmLeft, start_s, actor.beat(0.5), -0.9 * depth_deg);
    score.key(ArmRight, start_s + 0.04, actor.beat(0.5), -0.9 * depth_deg);
    score.key(Brow, start_s, actor.beat(0.3), 0.0);

    let rise_s = bowed_s + actor.dice.between(0.1, 0.7);
    score.key(NeckPitch, rise_s + 0.14, actor.beat(0.45), -actor.size(4.0));
    score.key(Eyelid, rise_s + 0.1, actor.beat(0.35), -1.0);
    score.key(Brow, rise_s + 0.2, actor.beat(0.3), actor.size(6.0));
    score.key(ArmLeft, rise_s + 0.1, actor.beat(0.5), 0.0);
    score.key(ArmRight, rise_s + 0.06, actor.beat(0.5), 0.0);
    score.key(BodyLean, rise_s, actor.beat(0.5), -actor.size(2.5))
}

/// Lifts one arm and waves twice to four times; the head tilts with it.
fn wave(score: &mut Score, actor: &mut Actor, start_s: f64) -> f64 {
    let arm = actor.near_arm();
    let raised_deg = actor.size(56.0);
    let dip = actor.dice.between(0.5, 0.75);
    let mut now_s = score.key(arm, start_s, actor.beat(0.35), raised_deg);
    score.key(NeckRoll, start_s + 0.1, actor.beat(0.4), actor.side * actor.size(8.0));
    score.key(Jaw, start_s + 0.15, actor.beat(0.3), actor.size(9.0));
    for _ in 0..actor.dice.count(2, 4) {
        let down_s = score.key(arm, now_s - 0.04, actor.beat(0.16), dip * raised_deg);
        now_s = score.key(arm, down_s - 0.03, actor.beat(0.16), raised_deg);
    }
    now_s
}

/// Pours tea: turns to the cup, lifts the pot, pours once or twice, looks up at the guest and sets
/// the pot down.
pub fn pour_tea(score: &mut Score, actor: &mut Actor) {
    let (pot_arm, lid_arm) = (actor.near_arm(), actor.far_arm());
    let cup_deg = actor.side * actor.size(24.0);
    let start_s = actor.beat(0.12);
    actor.turn_head(score, start_s, 0.32, 0.65 * cup_deg);
    score.key(NeckPitch, start_s + 0.1, actor.beat(0.4), actor.size(13.0));
    score.key(BodyYaw, start_s + 0.12, actor.beat(0.5), 0.6 * cup_deg);
    score.key(pot_arm, start_s + 0.1, actor.beat(0.22), -actor.size(8.0));
    let lift_s = start_s + actor.beat(0.32);
    let lifted_deg = actor.size(40.0);
    let lifted_s = score.key(pot_arm, lift_s, actor.beat(0.45), lifted_deg);
    score.key(lid_arm, lift_s + 0.15, actor.beat(0.45), actor.size(22.0));
    score.key(Brow, lift_s, actor.beat(0.4), -actor.size(5.0));
    score.key(Eyelid, lift_s, actor.beat(0.4), actor.size(5.0));

    let mut now_s = lifted_s - 0.05;
    if actor.dice.chance(0.4) {
        now_s = pour(score, actor, now_s, 0.45, lifted_deg);
    }
    let seconds = actor.dice.between(0.5, 1.0);
    now_s = pour(score, actor, now_s, seconds, lifted_deg);

    actor.turn_head(score, now_s, 0.32, 0.0);
    score.key(NeckPitch, now_s, actor.beat(0.35), -actor.size(6.0));
    score.key(Brow, now_s, actor.beat(0.22), actor.size(8.0));
    score.key(Eyelid, now_s, actor.beat(0.2), -1.0);
    score.key(Jaw, now_s + 0.15, actor.beat(0.3), 5.0 + 4.0 * actor.mood);
    score.key(pot_arm, now_s + 0.05, actor.beat(0.55), 0.0);
    score.key(lid_arm, now_s + 0.12, actor.beat(0.5), 0.0);
    let offered_s = score.key(BodyLean, now_s + 0.1, actor.beat(0.45), 0.0);
    actor.go_home(score, offered_s, 0.5);
}

/// Tips the pot, draws the stream up high, and cuts the last drop with a flick.
fn pour(score: &mut Score, actor: &mut Actor, start_s: f64, seconds: f64, lifted_deg: f64) -> f64 {
    let pot_arm = actor.near_arm();
    let tipped_s = score.key(pot_arm, start_s, actor.beat(0.32), 0.7 * lifted_deg);
    score.key(BodyLean, start_s, actor.beat(0.45), actor.size(9.0));
    score.key(NeckRoll, start_s + 0.1, actor.beat(0.5), actor.side * actor.size(9.0));
    let stream_s = tipped_s + actor.dice.between(0.0, 0.2);
    let drawn_deg = lifted_deg + actor.size(30.0) * seconds;
    let cut_s = score.key(pot_arm, stream_s, actor.beat(seconds), drawn_deg);
    score.key(NeckPitch, stream_s + 0.1, actor.beat(seconds), actor.size(6.0));
    score.bump(Whisk, cut_s + 0.05, actor.beat(0.3), actor.size(12.0));
    score.bump(pot_arm, cut_s, actor.beat(0.24), actor.size(11.0))
}
