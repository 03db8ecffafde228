//! Station 1b, the rotations: joint positions → root and local rotations, and how well they come back.
//!
//! In:  joint positions of all clips, from `represent`.
//! Out: [`ClipSet`] of rotations with its mean skeleton, and every clip's own bones.

use rayon::prelude::*;

use crate::body::Body;
use crate::body::infer_skeleton::infer_skeleton;
use crate::body::kinematics::{InverseKinematics, joint_distances, measure_offsets};
use crate::body::rotation::{Vector, add, length, scale, subtract};
use crate::body::skeleton::Skeleton;
use crate::clip::ClipSet;
use crate::error::Result;
use crate::layout::{GroupKind, Unit};
use crate::represent::{body_layout, joint_names, source_of};

/// A bone counts as constant while its length varies by less than this part of its mean.
const LENGTH_VARIATION_MAX: f64 = 1e-3;

/// Finds the rotations of all clips; `joints` start at the origin. // (clip, frame, joint)
///
/// Returns every clip's own bones too. // (clip, joint)
pub(crate) fn rotations(
    mut clip_set: ClipSet,
    joints: Vec<Vec<Vec<Vector>>>,
) -> Result<(ClipSet, Vec<Vec<Vector>>)> {
    let mut skeleton = match clip_set.skeleton.take() {
        Some(skeleton) => skeleton,
        None => {
            let names = joint_names(&clip_set);
            let skeleton = infer_skeleton(source_of(&clip_set), names, &joints)?;
            clip_set.remarks.push(format!("skeleton inferred: {}", tree_text(&skeleton)));
            skeleton
        }
    };
    let rest = rest_offsets(&skeleton, &joints);
    let solved: Vec<(Vec<Vector>, Vec<f32>)> =
        joints.par_iter().map(|frames| solve_clip(&skeleton, &rest, frames)).collect();
    let (bones, poses): (Vec<Vec<Vector>>, Vec<Vec<f32>>) = solved.into_iter().unzip();
    skeleton.offsets = mean_offsets(&bones);
    clip_set.skeleton = Some(skeleton.clone());
    clip_set.layout = body_layout(&clip_set, GroupKind::Rotation6d, joint_names(&clip_set));
    for (clip, poses) in clip_set.clips.iter_mut().zip(poses) {
        clip.poses = poses;
    }
    let remark = rotation_remark(&clip_set, &skeleton, &bones, &joints);
    clip_set.remarks.extend(remark);
    Ok((clip_set, bones))
}

fn tree_text(skeleton: &Skeleton) -> String {
    let bones = skeleton.bones();
    let names = &skeleton.names;
    bones
        .map(|(parent, child)| format!("{}-{}", names[parent], names[child]))
        .collect::<Vec<_>>()
        .join(" ")
}

/// The skeleton's rest directions; where it has none, those of the first pose of the first clip. //
/// (joint)
fn rest_offsets(skeleton: &Skeleton, joints: &[Vec<Vec<Vector>>]) -> Vec<Vector> {
    let mut rest: Vec<Vector> =
        skeleton.offsets.iter().map(|offset| offset.map(f64::from)).collect();
    if let Some(pose) = joints.iter().flatten().next() {
        for (parent, child) in skeleton.bones() {
            if length(rest[child]) == 0.0 {
                rest[child] = subtract(pose[child], pose[parent]);
            }
        }
    }
    rest
}

/// Own bones of one clip, and its poses as root and rotations. // (joint), (frame, channel)
fn solve_clip(
    skeleton: &Skeleton,
    rest: &[Vector],
    frames: &[Vec<Vector>],
) -> (Vec<Vector>, Vec<f32>) {
    let bones = measure_offsets(skeleton, rest, frames);
    let mut inverse = InverseKinematics::new(skeleton, &bones);
    let mut poses = Vec::with_capacity(frames.len() * (3 + 6 * skeleton.joint_count()));
    for positions in frames {
        poses.extend(positions[0].map(|element| element as f32));
        for local in inverse.solve(positions) {
            poses.extend(local.to_6d().map(|element| element as f32));
        }
    }
    (bones, poses)
}

fn mean_offsets(bones: &[Vec<Vector>]) -> Vec<[f32; 3]> {
    let joint_count = bones.first().map_or(0, Vec::len);
    (0..joint_count)
        .map(|joint| {
            let sum = bones.iter().fold([0.0; 3], |sum, clip| add(sum, clip[joint]));
            scale(sum, 1.0 / bones.len() as f64).map(|element| element as f32)
        })
        .collect()
}

/// Distances between joints and their reproductions.
#[derive(Clone, Copy, Default)]
struct Distance {
    total: f64,
    count: usize,
    max: f64,
}

impl Distance {
    fn of(distances: impl Iterator<Item = f64>) -> Self {
        distances.fold(Self::default(), |sum, distance| sum.with(distance, distance, 1))
    }

    fn with(self, total: f64, max: f64, count: usize) -> Self {
        Self { total: self.total + total, count: self.count + count, max: self.max.max(max) }
    }

    fn mean(&self) -> f64 {
        self.total / self.count.max(1) as f64
    }
}

/// What forward kinematics gives back of the original positions, on each clip's own bones and on
/// the mean ones.
fn rotation_remark(
    clip_set: &ClipSet,
    skeleton: &Skeleton,
    bones: &[Vec<Vector>],
    joints: &[Vec<Vec<Vector>>],
) -> Option<String> {
    let layout = &clip_set.layout;
    let body = Body::new(layout, Some(skeleton))?;
    let mean_bones: Vec<Vector> = skeleton.offsets.iter().map(|o| o.map(f64::from)).collect();
    let distance_on = |own: Option<&[Vec<Vector>]>| -> Distance {
        let of_clip = |index: usize| {
            let offsets = own.map_or(&mean_bones, |own| &own[index]);
            let poses = clip_set.clips[index].poses.chunks_exact(layout.channel_count());
            Distance::of(poses.zip(&joints[index]).flat_map(|(pose, original)| {
                let found = body.joint_positions_on(offsets, pose).unwrap_or_default();
                joint_distances(&found, original).collect::<Vec<f64>>()
            }))
        };
        (0..joints.len())
            .into_par_iter()
            .map(of_clip)
            .reduce(Distance::default, |a, b| a.with(b.total, b.max, b.count))
    };
    let constant = joints.iter().filter(|frames| has_constant_bones(skeleton, frames)).count();
    let (own, mean) = (distance_on(Some(bones)), distance_on(None));
    let unit = match layout.groups.first()?.unit {
        Unit::One => "units",
        unit => unit.suffix(),
    };
    Some(format!(
        "rotations by inverse kinematics: {constant} of {} clips have constant bone lengths; \
         joints come back within {:.2e} {unit} mean, {:.2e} {unit} max on each clip's own bones, \
         {:.2e} {unit} mean on the mean skeleton",
        joints.len(),
        own.mean(),
        own.max,
        mean.mean(),
    ))
}

fn has_constant_bones(skeleton: &Skeleton, frames: &[Vec<Vector>]) -> bool {
    skeleton.bones().all(|(parent, child)| {
        let lengths = frames.iter().map(|p| length(subtract(p[child], p[parent])));
        let range = lengths.fold((f64::INFINITY, 0.0_f64), |(min, max), length| {
            (min.min(length), max.max(length))
        });
        range.1 - range.0 <= LENGTH_VARIATION_MAX * range.1
    })
}
