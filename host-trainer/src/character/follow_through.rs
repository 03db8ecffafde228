//! Follow-through: every part is a mass on a spring that chases its goal, and moving parts drag
//! their neighbours.
//!
//! In:  goals of all joints ([`Score`]).
//! Out: poses of one clip, to [`clip_set`](super::clip_set).
//!
//! Why here: keys say what the character means to do; this says what its body makes of it. Heavy
//! parts arrive late, loose parts swing past, nothing outruns its servo or passes its end stop,
//! whatever the score asks for.
//! Source: damped spring x″ = ω²·(goal − x) − 2ζω·x′, semi-implicit Euler at 400 Hz.

use std::f64::consts::TAU;

use super::RATE_HZ;
use super::joint::{JOINT_COUNT, Joint, JointSpec};
use super::score::Score;

/// Integration steps between two poses.
const STEPS_PER_FRAME: u32 = 8;

/// A clip ends once no part is faster than this …
const STILL_DEG_PER_S: f64 = 3.0;

/// … for so many frames: a swinging part is slow for a moment wherever it turns.
const STILL_FRAME_COUNT: usize = 4;

/// Poses are whole multiples of this, so that CSV files hold them exactly; a 12-bit servo resolves
/// 0.04 degrees.
const RESOLUTION_PER_DEG: f64 = 100.0;

/// Kept below a servo's speed limit, so that rounding to the resolution cannot exceed it.
const SPEED_MARGIN_DEG_PER_S: f64 = 1.0;

/// Share of a joint's range, at each end, in which motion is slowed down towards the end stop.
const SOFT_SHARE: f64 = 0.1;

/// While `leader` moves, the goal of `follower` is shifted by `shift_s` times the leader's speed.
struct Drag {
    leader: Joint,
    follower: Joint,
    shift_s: f64,
}

const fn drag(leader: Joint, follower: Joint, shift_s: f64) -> Drag {
    Drag { leader, follower, shift_s }
}

/// Loose parts stay behind what carries them; the head rolls into its turns.
const DRAGS: [Drag; 9] = [
    drag(Joint::NeckPitch, Joint::Whisk, -0.05),
    drag(Joint::BodyLean, Joint::Whisk, -0.08),
    drag(Joint::NeckRoll, Joint::Whisk, 0.05),
    drag(Joint::NeckPitch, Joint::Brow, -0.02),
    drag(Joint::NeckYaw, Joint::NeckRoll, -0.025),
    drag(Joint::BodyLean, Joint::ArmLeft, -0.10),
    drag(Joint::BodyLean, Joint::ArmRight, -0.10),
    drag(Joint::BodyYaw, Joint::ArmLeft, -0.07),
    drag(Joint::BodyYaw, Joint::ArmRight, 0.07),
];

/// Position and speed of every part.
struct Body {
    angle_deg: [f64; JOINT_COUNT],
    speed_deg_per_s: [f64; JOINT_COUNT],
}

impl Body {
    fn at_rest(score: &Score) -> Self {
        Self {
            angle_deg: Joint::ALL.map(|joint| score.goal_deg(joint, 0.0)),
            speed_deg_per_s: [0.0; JOINT_COUNT],
        }
    }

    fn step(&mut self, score: &Score, time_s: f64) {
        const STEP_S: f64 = 1.0 / (RATE_HZ * STEPS_PER_FRAME as f64);
        let mut goal_deg = Joint::ALL.map(|joint| score.goal_deg(joint, time_s));
        for drag in &DRAGS {
            let shift_deg = drag.shift_s * self.speed_deg_per_s[drag.leader.index()];
            goal_deg[drag.follower.index()] += shift_deg;
        }
        for (index, joint) in Joint::ALL.iter().enumerate() {
            let spec = joint.spec();
            let omega = TAU * spec.frequency_hz;
            let speed = self.speed_deg_per_s[index];
            let pull = omega * omega * (goal_deg[index] - self.angle_deg[index]);
            let acceleration = pull - 2.0 * spec.damping_ratio * omega * speed;
            let limit = spec.speed_deg_per_s_max - SPEED_MARGIN_DEG_PER_S;
            let speed = (speed + STEP_S * acceleration).clamp(-limit, limit);
            self.speed_deg_per_s[index] = speed;
            self.angle_deg[index] += STEP_S * speed;
        }
    }

    fn is_still(&self) -> bool {
        let still = |speed: &f64| speed.abs() < STILL_DEG_PER_S;
        self.speed_deg_per_s.iter().all(still)
    }

    fn pose_deg(&self) -> impl Iterator<Item = f32> {
        let limited = Joint::ALL
            .iter()
            .zip(self.angle_deg)
            .map(|(joint, angle_deg)| soft_limit(angle_deg, joint.spec()));
        limited.map(|angle_deg| round_to_resolution(angle_deg) as f32)
    }
}

/// Identity in the middle of the range; near an end stop ever slower, never there.
fn soft_limit(angle_deg: f64, spec: &JointSpec) -> f64 {
    let soft_deg = SOFT_SHARE * (spec.max_deg - spec.min_deg);
    let squeeze = |excess_deg: f64| soft_deg * excess_deg / (soft_deg + excess_deg);
    let (low, high) = (spec.min_deg + soft_deg, spec.max_deg - soft_deg);
    if angle_deg > high {
        high + squeeze(angle_deg - high)
    } else if angle_deg < low {
        low - squeeze(low - angle_deg)
    } else {
        angle_deg
    }
}

/// The `+ 0.0` turns −0 into 0: it would be "-0.00" in a file.
fn round_to_resolution(angle_deg: f64) -> f64 {
    (angle_deg * RESOLUTION_PER_DEG + 0.5).floor() / RESOLUTION_PER_DEG + 0.0
}

/// Plays a score: at least `frame_count_min` poses, more until every part is still, never over
/// `frame_count_max`.
///
/// # Shapes
/// returns (frame, joint), degrees
pub fn play(score: &Score, frame_count_min: usize, frame_count_max: usize) -> Vec<f32> {
    let mut body = Body::at_rest(score);
    let mut poses = Vec::with_capacity(frame_count_max * JOINT_COUNT);
    let mut still_frame_count = 0;
    for frame in 0..frame_count_max {
        still_frame_count = if body.is_still() { still_frame_count + 1 } else { 0 };
        if frame >= frame_count_min && still_frame_count >= STILL_FRAME_COUNT {
            break;
        }
        poses.extend(body.pose_deg());
        for step in 0..STEPS_PER_FRAME {
            let step_position = f64::from(step) / f64::from(STEPS_PER_FRAME);
            body.step(score, (frame as f64 + step_position) / RATE_HZ);
        }
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score() -> Score {
        Score::new([0.0; JOINT_COUNT], 0.0)
    }

    fn channel(poses: &[f32], joint: Joint) -> Vec<f32> {
        let one = |pose: &[f32]| pose[joint.index()];
        poses.chunks(JOINT_COUNT).map(one).collect()
    }

    #[test]
    fn an_impossible_score_keeps_range_and_speed() {
        let mut score = score();
        for joint in Joint::ALL {
            for beat in 0..8 {
                let offset_deg = if beat % 2 == 0 { 400.0 } else { -400.0 };
                score.key(joint, 0.1 * f64::from(beat), 0.01, offset_deg);
            }
        }
        let poses = play(&score, 300, 300);
        for joint in Joint::ALL {
            let spec = joint.spec();
            let angles = channel(&poses, joint);
            let inside = |&a: &f32| (spec.min_deg..=spec.max_deg).contains(&f64::from(a));
            assert!(angles.iter().all(inside), "{}", spec.name);
            for pair in angles.windows(2) {
                let speed = f64::from(pair[1] - pair[0]).abs() * RATE_HZ;
                assert!(speed <= spec.speed_deg_per_s_max, "{}: {speed}", spec.name);
            }
        }
    }

    #[test]
    fn an_empty_score_is_true_stillness() {
        let poses = play(&score(), 60, 300);
        assert_eq!(poses.len(), 60 * JOINT_COUNT);
        assert!(poses.iter().all(|&angle| angle == 0.0));
    }

    #[test]
    fn a_loose_part_lags_and_swings_past_a_stiff_one_does_not() {
        let mut score = score();
        score.stroke(Joint::ArmLeft, 0.0, 0.25, 40.0);
        score.stroke(Joint::Eyelid, 0.0, 0.25, 12.0);
        let poses = play(&score, 100, 100);
        let peak = |joint| channel(&poses, joint).into_iter().fold(0.0, f32::max);
        assert!(peak(Joint::ArmLeft) > 42.0);
        assert!(peak(Joint::Eyelid) < 12.3);
        let arm_at_arrival = channel(&poses, Joint::ArmLeft)[12];
        assert!(arm_at_arrival < 38.0, "{arm_at_arrival}");
    }

    #[test]
    fn a_dragged_part_moves_though_nobody_keyed_it_and_comes_to_rest() {
        let mut score = score();
        score.key(Joint::NeckPitch, 0.2, 0.2, 20.0);
        let whisk = channel(&play(&score, 60, 300), Joint::Whisk);
        let lowest = whisk.iter().copied().fold(0.0, f32::min);
        let highest = whisk.iter().copied().fold(0.0, f32::max);
        assert!(lowest < -4.0 && highest > 1.0, "{lowest} {highest}");
        assert!(whisk[whisk.len() - 1].abs() < 1.0);
    }

    #[test]
    fn a_clip_goes_on_until_every_part_is_still() {
        let mut score = score();
        score.key(Joint::NeckPitch, 0.0, 0.2, 30.0);
        let frame_count = play(&score, 10, 300).len() / JOINT_COUNT;
        assert!((20..200).contains(&frame_count), "{frame_count}");
    }
}
