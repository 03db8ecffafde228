//! Yes and no.

use crate::character::actor::Actor;
use crate::character::joint::Joint::{
    ArmLeft, ArmRight, BodyLean, BodyYaw, Brow, Eyelid, Jaw, NeckPitch, NeckRoll,
};
use crate::character::score::Score;

/// Nods once to four times: the head lifts a little first, each nod snaps down, lingers and comes
/// back more slowly. Some actors begin with the deepest nod, others work up to it; the thoughtful
/// stay down in the last one.
pub fn nod(score: &mut Score, actor: &mut Actor) {
    let start_s = actor.beat(0.12);
    let lift_end_s = score.key(NeckPitch, start_s, actor.beat(0.18), -actor.size(5.0));
    score.key(Brow, start_s, actor.beat(0.2), actor.size(4.0 + 3.0 * actor.mood));
    score.key(BodyLean, start_s + 0.05, actor.beat(0.5), actor.size(4.0));
    if actor.dice.chance(0.5) {
        let guest_deg = actor.side * actor.size(11.0);
        actor.turn_head(score, start_s, 0.3, guest_deg);
        score.key(NeckRoll, start_s + 0.05, actor.beat(0.35), 0.5 * guest_deg);
        score.key(BodyYaw, start_s + 0.12, actor.beat(0.5), 0.4 * guest_deg);
    }

    let nod_count = actor.dice.count(1, 4);
    let works_up = nod_count > 1 && actor.dice.chance(0.35);
    let depth_ratio = actor.dice.between(0.55, 0.85);
    let mut depth_deg = actor.size(if works_up { 11.0 } else { 20.0 });
    let mut now_s = lift_end_s - 0.04;
    for nod in 1..=nod_count {
        let mut down_s = score.key(NeckPitch, now_s, actor.beat(0.17), depth_deg);
        score.bump(BodyLean, now_s + 0.03, actor.beat(0.4), 0.2 * depth_deg);
        score.bump(ArmLeft, now_s + 0.06, actor.beat(0.4), -0.35 * depth_deg);
        score.bump(ArmRight, now_s + 0.09, actor.beat(0.4), -0.35 * depth_deg);
        if nod == 1 && actor.dice.chance(0.4) {
            actor.blink(score, now_s);
        }
        if nod == nod_count {
            down_s += actor.dice.between(0.0, 0.3 - 0.15 * actor.mood);
        }
        let back_deg = -0.12 * depth_deg;
        now_s = score.key(NeckPitch, down_s, actor.beat(0.24), back_deg);
        now_s -= actor.dice.between(-0.05, 0.05);
        depth_deg *= if works_up { 1.0 / depth_ratio } else { depth_ratio };
    }
    if actor.mood > 0.2 {
        score.bump(Jaw, now_s - 0.3, actor.beat(0.7), 5.0 + 6.0 * actor.mood);
    }
    actor.go_home(score, now_s, 0.35);
}

/// Shakes its head, each sweep smaller, the body swinging against it, brows down. The gloomy do it
/// slowly with a low head and lids almost shut.
pub fn shake(score: &mut Score, actor: &mut Actor) {
    let gloom = 0.5 - 0.5 * actor.mood;
    let start_s = actor.beat(0.12);
    score.key(Brow, start_s, actor.beat(0.22), -actor.size(6.0 + 4.0 * gloom));
    score.key(Eyelid, start_s + 0.04, actor.beat(0.25), actor.size(3.0 + 9.0 * gloom));
    score.key(NeckPitch, start_s, actor.beat(0.3), actor.size(1.0 + 11.0 * gloom));
    score.key(NeckRoll, start_s, actor.beat(0.5), actor.side * actor.size(4.0));

    let mut to_side = actor.side;
    let sweep_size_deg = actor.dice.between(20.0, 40.0);
    let mut sweep_deg = actor.size(sweep_size_deg);
    let sweep_s = actor.dice.between(0.16, 0.26) + 0.1 * gloom;
    let body_share = actor.dice.between(0.1, 0.4);
    let mut now_s = actor.turn_head(score, start_s, 0.2, -0.25 * to_side * sweep_deg);
    for _ in 0..actor.dice.count(2, 6) {
        let body_deg = -body_share * to_side * sweep_deg;
        score.key(BodyYaw, now_s + 0.04, actor.beat(1.2 * sweep_s), body_deg);
        score.bump(ArmLeft, now_s + 0.08, actor.beat(0.35), -0.2 * sweep_deg);
        score.bump(ArmRight, now_s + 0.1, actor.beat(0.35), -0.2 * sweep_deg);
        now_s = actor.turn_head(score, now_s - 0.03, sweep_s, to_side * sweep_deg);
        to_side = -to_side;
        sweep_deg *= actor.dice.between(0.68, 0.95);
    }
    now_s += actor.dice.between(-0.05, 0.5 * gloom);
    actor.go_home(score, now_s, 0.42);
}
