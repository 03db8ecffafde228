//! Local transforms of all joints in all clips → root translation, rotations, and a skeleton of
//! what stands still.
//!
//! Why here: whether a translation is a bone or a motion can only be seen over all clips. And many
//! exporters put a still joint above the hips; kinematics with one moving root needs the hips to be
//! that root, so the joint above is folded into them. The child's place in the world does not
//! change by that.

use std::path::Path;

use super::super::{Recordings, Remarks};
use super::parser::Joint;
use crate::body::rotation::{Rotation, Vector, add, length, scale, subtract};
use crate::body::skeleton::Skeleton;
use crate::layout::{Group, GroupKind, PoseLayout, Unit};
use crate::represent::ROOT_NAME;

/// Numbers of a transform: translation x, y, z and the 6D rotation.
const TRANSFORM_LEN: usize = 9;

/// A translation that stays within this share of the longest offset is a bone; files carry six
/// digits.
const STILL_SHARE: f64 = 1e-3;

/// The transforms of every clip.
pub(super) struct JointMotion {
    /// Names, parents and scaled offsets.
    pub joints: Vec<Joint>,
    /// Unit of translations.
    pub unit: Unit,
    pub clips: Vec<Vec<f32>>, // (clip, (frame, joint, 9))
}

/// How one joint's translation behaves.
struct Bone {
    /// Mean over all frames of all clips.
    mean: Vector,
    /// Largest extent along any axis within one clip.
    travel: f64,
    /// Largest distance of a clip's mean from `mean`.
    spread: f64,
}

impl JointMotion {
    /// The layout of the transforms: a translation and a rotation for every joint.
    pub fn layout(&self) -> PoseLayout {
        let groups = self.joints.iter().flat_map(|joint| {
            [self.translation(&format!("{}_translation", joint.name)), rotation(&joint.name)]
        });
        PoseLayout { groups: groups.collect() }
    }

    /// Sorts what moves from what stands still.
    pub fn into_recordings(
        mut self,
        rate_hz: f64,
        first: &Path,
        remarks: &mut Remarks,
    ) -> Recordings {
        let longest = self.joints.iter().map(|joint| length(joint.offset)).fold(0.0, f64::max);
        let tolerance = STILL_SHARE * longest;
        let bones: Vec<Bone> = (0..self.joints.len()).map(|joint| self.bone(joint)).collect();
        let root = self.fold_root(&bones, tolerance, first, remarks);
        self.rename_root_joint();
        let moves = |joint: usize| joint != root && bones[joint].travel > tolerance;
        for joint in (root + 1..self.joints.len()).filter(|&joint| moves(joint)) {
            let name = &self.joints[joint].name;
            let text = format!("{name} also travels; its translation becomes channels of its own");
            remarks.note(first, text);
        }
        let spread = bones[root + 1..].iter().map(|bone| bone.spread).fold(0.0, f64::max);
        if spread > tolerance {
            let unit = self.unit.suffix();
            let text =
                format!("bones differ between clips by up to {spread:.3} {unit}; means are used");
            remarks.note(first, text);
        }
        Recordings {
            layout: self.moving_layout(root, moves),
            rate_hz,
            skeleton: Some(self.skeleton(root, &bones)),
            poses: self.clips.iter().map(|clip| self.moving_poses(clip, root, moves)).collect(),
        }
    }

    fn translation(&self, name: &str) -> Group {
        Group { name: name.into(), kind: GroupKind::Translation, unit: self.unit }
    }

    fn bone(&self, joint: usize) -> Bone {
        let clip_bones: Vec<(Vector, f64)> =
            self.clips.iter().map(|clip| self.mean_and_travel(clip, joint)).collect();
        let sum = clip_bones.iter().fold([0.0; 3], |sum, (mean, _)| add(sum, *mean));
        let mean = scale(sum, 1.0 / clip_bones.len() as f64);
        let distances = clip_bones.iter().map(|(clip, _)| length(subtract(*clip, mean)));
        Bone {
            mean,
            travel: clip_bones.iter().map(|(_, travel)| *travel).fold(0.0, f64::max),
            spread: distances.fold(0.0, f64::max),
        }
    }

    fn mean_and_travel(&self, clip: &[f32], joint: usize) -> (Vector, f64) {
        let start = joint * TRANSFORM_LEN;
        let frames = clip.chunks_exact(self.joints.len() * TRANSFORM_LEN);
        let frame_count = frames.len() as f64;
        let (mut min, mut max, mut sum) = ([f64::MAX; 3], [f64::MIN; 3], [0.0; 3]);
        for frame in frames {
            for axis in 0..3 {
                let value = f64::from(frame[start + axis]);
                min[axis] = value.min(min[axis]);
                max[axis] = value.max(max[axis]);
                sum[axis] += value;
            }
        }
        let travel = (0..3).map(|axis| max[axis] - min[axis]).fold(0.0, f64::max);
        (scale(sum, 1.0 / frame_count), travel)
    }

    /// Folds the root into its only child as long as that travels and branches, as hips do.
    ///
    /// An only child follows its parent in the order of declaration, so the new root's index says
    /// how many went.
    fn fold_root(
        &mut self,
        bones: &[Bone],
        tolerance: f64,
        first: &Path,
        remarks: &mut Remarks,
    ) -> usize {
        let width = self.joints.len() * TRANSFORM_LEN;
        let mut root = 0;
        loop {
            let is_hips = |joint| self.child_count(joint) > 1 && bones[joint].travel > tolerance;
            if self.child_count(root) != 1 || !is_hips(root + 1) {
                return root;
            }
            let (parent, child) = (&self.joints[root].name, &self.joints[root + 1].name);
            remarks.note(first, format!("{parent} is folded into {child}, which is the root now"));
            for pose in self.clips.iter_mut().flat_map(|clip| clip.chunks_exact_mut(width)) {
                let (parent, child) = pose[root * TRANSFORM_LEN..].split_at_mut(TRANSFORM_LEN);
                fold(parent, &mut child[..TRANSFORM_LEN]);
            }
            root += 1;
        }
    }

    fn child_count(&self, parent: usize) -> usize {
        let is_child = |joint: &&Joint| joint.parent == Some(parent);
        self.joints.iter().filter(is_child).count()
    }

    /// The root's translation is called "root"; a joint of that name makes room.
    fn rename_root_joint(&mut self) {
        if let Some(joint) = self.joints.iter_mut().find(|joint| joint.name == ROOT_NAME) {
            joint.name.push_str("_joint");
        }
    }

    fn moving_layout(&self, root: usize, moves: impl Fn(usize) -> bool) -> PoseLayout {
        let mut groups = vec![self.translation(ROOT_NAME)];
        for (index, joint) in self.joints.iter().enumerate().skip(root) {
            if moves(index) {
                groups.push(self.translation(&format!("{}_translation", joint.name)));
            }
            groups.push(rotation(&joint.name));
        }
        PoseLayout { groups }
    }

    fn moving_poses(&self, clip: &[f32], root: usize, moves: impl Fn(usize) -> bool) -> Vec<f32> {
        let transforms = clip.chunks_exact(TRANSFORM_LEN).enumerate();
        let kept = transforms.flat_map(|(index, transform)| {
            let joint = index % self.joints.len();
            let start = match joint {
                _ if joint < root => TRANSFORM_LEN,
                _ if joint == root || moves(joint) => 0,
                _ => 3,
            };
            &transform[start..]
        });
        kept.copied().collect()
    }

    fn skeleton(&self, root: usize, bones: &[Bone]) -> Skeleton {
        let joints = &self.joints[root..];
        let offset = |bone: &Bone| bone.mean.map(|component| component as f32);
        let mut offsets: Vec<[f32; 3]> = bones[root..].iter().map(offset).collect();
        offsets[0] = [0.0; 3]; // The root's place is a channel, not a bone.
        Skeleton {
            names: joints.iter().map(|joint| joint.name.clone()).collect(),
            parents: joints
                .iter()
                .map(|joint| joint.parent.and_then(|parent| parent.checked_sub(root)))
                .collect(),
            offsets,
        }
    }
}

fn rotation(name: &str) -> Group {
    Group { name: name.into(), kind: GroupKind::Rotation6d, unit: Unit::One }
}

/// Replaces a child's local transform by `parent · child`; what is not finite stays visible.
fn fold(parent: &[f32], child: &mut [f32]) {
    if !parent.iter().chain(child.iter()).all(|value| value.is_finite()) {
        child.fill(f32::NAN);
        return;
    }
    let vector = |t: &[f32]| [f64::from(t[0]), f64::from(t[1]), f64::from(t[2])];
    let turn = |t: &[f32]| Rotation::from_6d(&std::array::from_fn(|i| f64::from(t[3 + i])));
    let rotation = turn(parent).after(&turn(child));
    let translation = add(vector(parent), turn(parent).apply(vector(child)));
    let folded = translation.into_iter().chain(rotation.to_6d());
    child.iter_mut().zip(folded).for_each(|(slot, value)| *slot = value as f32);
}
