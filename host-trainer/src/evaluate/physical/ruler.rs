//! What has to be known of a body before its motions can be measured: up, feet, bones, size.
//!
//! In:  the real motions, and nothing that was generated.
//! Out: [`Ruler`], the same for every set of motions of an evaluation.
//!
//! Why here: sources disagree on which way is up and name their joints as they like, so it is all found from the
//! motions: up as pictures find it, feet as the two joints that are most often the lowest, bones as the tree of
//! the steadiest distances.

use crate::body::infer_skeleton::infer_parents;
use crate::body::rotation::{Vector, dot};
use crate::body::skeleton::Skeleton;
use crate::evaluate::real::{RealMotion, RealMotions};
use crate::picture::view::View;

/// A body, as far as measuring needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct Ruler {
    /// Unit vector against gravity.
    pub up: Vector,
    /// The two joints that stand on the floor; fewer for a body of one joint.
    pub feet: Vec<usize>,
    /// Joints at both ends of every bone.
    pub bones: Vec<(usize, usize)>,
    /// Up to this height over the floor a foot is down, metres.
    pub contact_height_m: f64,
    /// Poses per second.
    pub rate_hz: f64,
}

/// Clips that are looked at, evenly spaced: enough to know a body.
const CLIPS_MAX: usize = 200;

/// A foot is down below this share of the body's height: 5 cm of 1.7 m.
const CONTACT_SHARE: f64 = 0.03;

impl Ruler {
    /// Reads it off the training clips.
    pub fn new(real: &RealMotions) -> Self {
        let step = real.training.len().div_ceil(CLIPS_MAX).max(1);
        let channel_count = real.channel_count();
        let frames_of = |clip: &RealMotion| {
            let poses = clip.positions.chunks_exact(channel_count);
            poses.map(joints_of).collect::<Vec<Vec<Vector>>>()
        };
        let clips: Vec<Vec<Vec<Vector>>> =
            real.training.iter().step_by(step).map(frames_of).collect();
        let joint_count = real.joints.len();
        let named = Skeleton {
            names: real.joints.clone(),
            parents: vec![None; joint_count],
            offsets: vec![[0.0; 3]; joint_count],
        };
        let up = View::of(Some(&named), &clips).up;
        let parents = infer_parents(joint_count, &clips).into_iter().enumerate();
        let poses: Vec<&Vec<Vector>> = clips.iter().flatten().collect();
        Self {
            up,
            feet: feet(&poses, up, joint_count),
            bones: parents.filter_map(|(joint, parent)| Some((joint, parent?))).collect(),
            contact_height_m: CONTACT_SHARE * body_height(&poses, up),
            rate_hz: real.rate_hz,
        }
    }
}

fn joints_of(pose: &[f32]) -> Vec<Vector> {
    let joints = pose.chunks_exact(3);
    joints.map(|xyz| std::array::from_fn(|axis| f64::from(xyz[axis]))).collect()
}

/// The two joints that are most often the lowest of a pose.
fn feet(poses: &[&Vec<Vector>], up: Vector, joint_count: usize) -> Vec<usize> {
    let mut counts = vec![0; joint_count];
    for pose in poses {
        let lowest = (0..pose.len()).min_by(|a, b| dot(pose[*a], up).total_cmp(&dot(pose[*b], up)));
        if let Some(joint) = lowest {
            counts[joint] += 1;
        }
    }
    let mut joints = Vec::from_iter(0..joint_count);
    joints.sort_by_key(|joint| std::cmp::Reverse(counts[*joint]));
    joints.truncate(2);
    joints
}

/// How tall the body stands: nine of ten poses are lower from the lowest joint to the highest.
fn body_height(poses: &[&Vec<Vector>], up: Vector) -> f64 {
    let extent = |pose: &&Vec<Vector>| {
        let heights = pose.iter().map(|joint| dot(*joint, up));
        let ends = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), height| {
            (low.min(height), high.max(height))
        });
        ends.1 - ends.0
    };
    let mut extents: Vec<f64> = poses.iter().map(extent).collect();
    extents.sort_unstable_by(f64::total_cmp);
    extents.get(extents.len() * 9 / 10).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clip::{Clip, ClipSet};
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};

    /// Hip, two feet and a head; `up` is an axis and a sign. The feet lift in turns, the head nods.
    fn walker(axis: usize, sign: f32) -> ClipSet {
        let names = ["a", "b", "c", "d"];
        let joint = |name: &str| Group {
            name: name.to_owned(),
            kind: GroupKind::Position,
            unit: Unit::Metre,
        };
        let pose = |frame: usize| {
            let phase = frame as f32 * 0.4;
            let lift = [phase.sin().max(0.0), (-phase.sin()).max(0.0)].map(|lift| 0.2 * lift);
            let heights = [0.9 + 0.05 * phase.cos(), lift[0], lift[1], 1.6 + 0.2 * phase.cos()];
            let across = [0.0, 0.2, -0.2, 0.0];
            heights.into_iter().zip(across).flat_map(move |(height, across)| {
                let mut xyz = [0.0; 3];
                xyz[0] = across;
                xyz[axis] = sign * height;
                xyz
            })
        };
        let clip = Clip {
            name: "walk".to_owned(),
            action: "walk".to_owned(),
            source: "memory".into(),
            poses: (0..60).flat_map(pose).collect(),
        };
        ClipSet {
            layout: PoseLayout { groups: names.map(joint).to_vec() },
            rate_hz: 30.0,
            skeleton: None,
            clips: vec![clip],
            remarks: Vec::new(),
        }
    }

    #[test]
    fn up_and_feet_are_found_whichever_axis_points_up() {
        for (axis, sign) in [(1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
            let ruler = Ruler::new(&RealMotions::new(&walker(axis, sign), None).unwrap());
            let mut up = [0.0; 3];
            up[axis] = f64::from(sign);
            assert_eq!(ruler.up, up);
            let mut feet = ruler.feet.clone();
            feet.sort_unstable();
            assert_eq!(feet, [1, 2], "{axis} {sign}");
            assert_eq!(ruler.bones.len(), 3);
            assert!((ruler.contact_height_m - 0.03 * 1.75).abs() < 0.01, "{ruler:?}");
        }
    }
}
