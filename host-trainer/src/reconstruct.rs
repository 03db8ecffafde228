//! How well a decoder gives its training clips back, in units that mean something.
//!
//! In:  a checkpoint or a blob, with the dataset that it was trained on.
//! Out: errors per kind of channel group and, for bodies, of the joints in millimetres, root and local apart.
//!
//! Why here: the same figures are wanted of the float model and of every number format, so the source of the poses is
//! the only thing that differs. Mean codes, no noise (published code: evaluation mode).

use karakuri::{Decoder, FramePosition, Model, Pose, Unit, Workspace};
use rayon::prelude::*;
use serde::Serialize;

use crate::body::Body;
use crate::body::rotation::{Rotation, Vector, length, subtract};
use crate::checkpoint::Checkpoint;
use crate::dataset::{Dataset, DatasetDescription};
use crate::layout::GroupKind;
use crate::train::metrics::report_unit;

/// Where poses come from.
#[derive(Clone, Copy)]
pub enum Source<'a> {
    /// The float model.
    Float,
    /// A blob of the same checkpoint, in core's arithmetic.
    Blob(&'a Model<'a>),
}

/// Errors over every frame of every training clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reconstruction {
    /// Frames compared.
    pub frame_count: usize,
    /// Per kind and unit of channel group.
    pub groups: Vec<GroupError>,
    /// Of the joints; `None` where the layout is not a body.
    pub joints: Option<JointError>,
}

/// Errors of all groups of one kind and unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupError {
    /// What the channels are.
    pub kind: &'static str,
    /// `deg`, `mm`, or the channels' own unit.
    pub unit: &'static str,
    /// Root mean square: per channel of scalars, of the length of the difference for vectors, of the angle between
    /// rotations.
    pub rms: f64,
    /// Mean of the same magnitudes.
    pub mean: f64,
}

/// Mean distance per joint over all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct JointError {
    /// Of joints in space.
    pub joint_mm: f64,
    /// Of the root.
    pub root_mm: f64,
    /// Of joints relative to the root of their frame.
    pub local_mm: f64,
}

#[derive(Default)]
struct Sums {
    frame_count: usize,
    /// Sum of squares, sum, count. // (group)
    groups: Vec<(f64, f64, f64)>,
    joints: JointError,
    joint_count: f64,
}

/// Decodes every `stride`-th frame of every training clip from its mean code and compares.
///
/// `bones` are the clips' own where rotations were found by inverse kinematics (see `represent_with_bones`), else empty.
pub fn reconstruct(
    checkpoint: &Checkpoint,
    source: Source<'_>,
    dataset: &Dataset,
    bones: &[Vec<Vector>],
    stride: usize,
) -> Reconstruction {
    let description = &dataset.description;
    let body = Body::new(&description.layout, description.skeleton.as_ref());
    let clips = 0..description.clips.len();
    let sums = clips.into_par_iter().map(|clip| {
        let frames: Vec<usize> =
            (0..description.clips[clip].frame_count).step_by(stride.max(1)).collect();
        let decoded = decode_clip(checkpoint, source, description, clip, &frames);
        let mut original = dataset.clip_poses(clip).to_vec();
        description.destandardize(&mut original);
        compare(description, body.as_ref(), bones.get(clip), &original, &decoded, &frames)
    });
    let sums = sums.collect::<Vec<_>>().into_iter().fold(Sums::default(), Sums::add);
    sums.finish(description, body.is_some())
}

fn decode_clip(
    checkpoint: &Checkpoint,
    source: Source<'_>,
    description: &DatasetDescription,
    clip: usize,
    frames: &[usize],
) -> Vec<f32> {
    let code = checkpoint.mean_code(clip);
    match source {
        Source::Float => {
            let times: Vec<f64> = frames.iter().map(|&frame| frame as f64).collect();
            let mut poses = vec![0.0; frames.len() * description.layout.channel_count()];
            checkpoint.model.decode_motion(&code, &times, &mut poses);
            description.destandardize(&mut poses);
            poses
        }
        Source::Blob(model) => {
            let mut workspace = Box::new(Workspace::<{ karakuri::limits::WIDTH_MAX }>::new());
            let (mut poses, mut pose) = (Vec::new(), Pose::new());
            if let Ok(mut decoder) = Decoder::new(model, &mut *workspace) {
                decoder.start(&model.code_from_f32(&code));
                for &frame in frames {
                    decoder.decode(FramePosition::from_frames(frame as u32), &mut pose);
                    poses.extend(pose.values().map(|value| value as f32));
                }
            }
            poses
        }
    }
}

fn compare(
    description: &DatasetDescription,
    body: Option<&Body>,
    bones: Option<&Vec<Vector>>,
    original: &[f32],
    decoded: &[f32],
    frames: &[usize],
) -> Sums {
    let width = description.layout.channel_count();
    let mut sums =
        Sums { groups: vec![(0.0, 0.0, 0.0); description.layout.groups.len()], ..Sums::default() };
    for (decoded, &frame) in decoded.chunks_exact(width).zip(frames) {
        let original = &original[frame * width..(frame + 1) * width];
        sums.frame_count += 1;
        for (sum, (group, range)) in sums.groups.iter_mut().zip(description.layout.ranges()) {
            let error = group_error(group.kind, &original[range.clone()], &decoded[range]);
            *sum = (sum.0 + error * error, sum.1 + error, sum.2 + 1.0);
        }
        if let Some(body) = body {
            let joints = |pose| {
                let on_own_bones = bones.and_then(|offsets| body.joint_positions_on(offsets, pose));
                on_own_bones.unwrap_or_else(|| body.joint_positions(pose))
            };
            sums.add_joints(&joints(original), &joints(decoded));
        }
    }
    sums
}

/// Magnitude of the difference: absolute value, Euclidean length, or angle in radians.
fn group_error(kind: GroupKind, original: &[f32], decoded: &[f32]) -> f64 {
    if kind == GroupKind::Rotation6d {
        let rotation =
            |channels: &[f32]| Rotation::from_6d(&std::array::from_fn(|i| f64::from(channels[i])));
        return rotation(original).angle_to_rad(&rotation(decoded));
    }
    let squares = original.iter().zip(decoded).map(|(a, b)| f64::from(a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

impl Sums {
    fn add_joints(&mut self, original: &[Vector], decoded: &[Vector]) {
        let (Some(&root), Some(&decoded_root)) = (original.first(), decoded.first()) else {
            return;
        };
        self.joints.root_mm += length(subtract(root, decoded_root)) * original.len() as f64;
        for (&joint, &decoded_joint) in original.iter().zip(decoded) {
            self.joints.joint_mm += length(subtract(joint, decoded_joint));
            let local = subtract(subtract(joint, root), subtract(decoded_joint, decoded_root));
            self.joints.local_mm += length(local);
            self.joint_count += 1.0;
        }
    }

    fn add(mut self, other: Self) -> Self {
        self.frame_count += other.frame_count;
        self.groups.resize(other.groups.len().max(self.groups.len()), (0.0, 0.0, 0.0));
        for (sum, add) in self.groups.iter_mut().zip(other.groups) {
            *sum = (sum.0 + add.0, sum.1 + add.1, sum.2 + add.2);
        }
        self.joints.joint_mm += other.joints.joint_mm;
        self.joints.root_mm += other.joints.root_mm;
        self.joints.local_mm += other.joints.local_mm;
        self.joint_count += other.joint_count;
        self
    }

    fn finish(self, description: &DatasetDescription, is_body: bool) -> Reconstruction {
        let groups = description.layout.groups.iter().zip(self.groups);
        let mut merged: Vec<(GroupKind, Unit, (f64, f64, f64))> = Vec::new();
        for (group, sum) in groups {
            match merged
                .iter_mut()
                .find(|(kind, unit, _)| (*kind, *unit) == (group.kind, group.unit))
            {
                Some((_, _, all)) => *all = (all.0 + sum.0, all.1 + sum.1, all.2 + sum.2),
                None => merged.push((group.kind, group.unit, sum)),
            }
        }
        let report = |(kind, unit, (squares, sum, count)): (GroupKind, Unit, (f64, f64, f64))| {
            let (unit, factor) = magnitude_unit(kind, unit);
            let count = count.max(1.0);
            GroupError {
                kind: kind.name(),
                unit,
                rms: (squares / count).sqrt() * factor,
                mean: sum / count * factor,
            }
        };
        let millimetres = root_unit(description).map_or(1.0, |unit| report_unit(unit).1)
            / self.joint_count.max(1.0);
        let joints = is_body.then_some(JointError {
            joint_mm: self.joints.joint_mm * millimetres,
            root_mm: self.joints.root_mm * millimetres,
            local_mm: self.joints.local_mm * millimetres,
        });
        Reconstruction {
            frame_count: self.frame_count,
            groups: merged.into_iter().map(report).collect(),
            joints,
        }
    }
}

fn root_unit(description: &DatasetDescription) -> Option<Unit> {
    let is_length = |kind| matches!(kind, GroupKind::Translation | GroupKind::Position);
    description.layout.groups.iter().find(|group| is_length(group.kind)).map(|group| group.unit)
}

/// The unit of a kind's error magnitudes in reports, and the factor to it.
fn magnitude_unit(kind: GroupKind, unit: Unit) -> (&'static str, f64) {
    // The difference between rotations is an angle, whatever unit its channels have.
    report_unit(if kind == GroupKind::Rotation6d { Unit::Radian } else { unit })
}
