//! How well a decoder gives clips back, in units that mean something.
//!
//! In:  a checkpoint or a blob, with the dataset whose codes it has: that of the training, or held-out clips.
//! Out: errors per kind of channel group, per group and, for bodies, of the joints in millimetres, root and local
//! apart.
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
use crate::layout::{Group, GroupKind};
use crate::train::metrics::report_unit;

/// Where poses come from.
#[derive(Clone, Copy)]
pub enum Source<'a> {
    /// The float model.
    Float,
    /// A blob of the same checkpoint, in core's arithmetic.
    Blob(&'a Model<'a>),
}

/// Errors over every frame of every clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reconstruction {
    /// Frames compared.
    pub frame_count: usize,
    /// Per kind and unit of channel group.
    pub kinds: Vec<GroupError>,
    /// Per channel group: joint or servo.
    pub groups: Vec<GroupError>,
    /// Of the joints; `None` where the layout is not a body.
    pub joints: Option<JointError>,
}

/// Errors of one channel group, or of all groups of one kind and unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupError {
    /// Name of the group or the kind.
    pub of: String,
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
    /// // (group)
    groups: Vec<Magnitudes>,
    joints: JointError,
    joint_count: f64,
}

/// What remains of many errors of one channel group.
#[derive(Clone, Copy, Default)]
struct Magnitudes {
    squares: f64,
    sum: f64,
    count: f64,
}

/// Decodes every `stride`-th frame of every clip from its mean code and compares.
///
/// `bones` are the clips' own where rotations were found by inverse kinematics (see `represent_with_bones`), else
/// empty.
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
    let mut sums = Sums {
        groups: vec![Magnitudes::default(); description.layout.groups.len()],
        ..Sums::default()
    };
    for (decoded, &frame) in decoded.chunks_exact(width).zip(frames) {
        let original = &original[frame * width..(frame + 1) * width];
        sums.frame_count += 1;
        for (sum, (group, range)) in sums.groups.iter_mut().zip(description.layout.ranges()) {
            let error = group_error(group.kind, &original[range.clone()], &decoded[range]);
            sum.add(&Magnitudes { squares: error * error, sum: error, count: 1.0 });
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

impl Magnitudes {
    fn add(&mut self, other: &Self) {
        self.squares += other.squares;
        self.sum += other.sum;
        self.count += other.count;
    }

    fn report(&self, of: &str, (unit, factor): (&'static str, f64)) -> GroupError {
        let count = self.count.max(1.0);
        GroupError {
            of: of.to_owned(),
            unit,
            rms: (self.squares / count).sqrt() * factor,
            mean: self.sum / count * factor,
        }
    }
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
        self.groups.resize(other.groups.len().max(self.groups.len()), Magnitudes::default());
        for (sum, add) in self.groups.iter_mut().zip(other.groups) {
            sum.add(&add);
        }
        self.joints.joint_mm += other.joints.joint_mm;
        self.joints.root_mm += other.joints.root_mm;
        self.joints.local_mm += other.joints.local_mm;
        self.joint_count += other.joint_count;
        self
    }

    fn finish(self, description: &DatasetDescription, is_body: bool) -> Reconstruction {
        let groups = || description.layout.groups.iter().zip(&self.groups);
        let mut kinds: Vec<(GroupKind, Unit, Magnitudes)> = Vec::new();
        for (group, magnitudes) in groups() {
            let key = (group.kind, group.unit);
            match kinds.iter_mut().find(|(kind, unit, _)| (*kind, *unit) == key) {
                Some((_, _, all)) => all.add(magnitudes),
                None => kinds.push((group.kind, group.unit, *magnitudes)),
            }
        }
        let of_kind = |(kind, unit, all): &(GroupKind, Unit, Magnitudes)| {
            all.report(kind.name(), magnitude_unit(*kind, *unit))
        };
        let of_group = |(group, all): (&Group, &Magnitudes)| {
            all.report(&group.name, magnitude_unit(group.kind, group.unit))
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
            kinds: kinds.iter().map(of_kind).collect(),
            groups: groups().map(of_group).collect(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::synthetic::{config, dataset};

    #[test]
    fn groups_are_reported_apart_and_joined_by_kind_and_unit() {
        let dataset = dataset();
        let checkpoint = Checkpoint::start(&dataset, &config(""));
        let found = reconstruct(&checkpoint, Source::Float, &dataset, &[], 1);
        let of = |errors: &[GroupError]| -> Vec<String> {
            errors.iter().map(|error| format!("{} {}", error.of, error.unit)).collect()
        };
        assert_eq!(found.frame_count, 106);
        assert_eq!(of(&found.groups), ["jaw deg", "root mm", "lid deg", "brow deg"]);
        // The lid's channel is in radians: another unit than that of jaw and brow.
        assert_eq!(of(&found.kinds), ["scalar deg", "translation mm", "scalar deg"]);
        let (jaw, brow) = (found.groups[0].rms, found.groups[3].rms);
        let joined = ((jaw * jaw + brow * brow) / 2.0).sqrt();
        assert!((found.kinds[0].rms / joined - 1.0).abs() < 1e-9);
        assert!(found.groups.iter().all(|group| group.mean <= group.rms));
    }
}
