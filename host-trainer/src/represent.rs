//! Station 1b: clips as imported → clips as trained.
//!
//! In:  [`ClipSet`] of an importer; human joints come as absolute positions, one `Position` group a joint.
//! Out: [`ClipSet`] in its training representation to `dataset`; joint positions to pictures and metrics.
//!
//! Why here: the decoder learns what it is given. Positions are simplest and exact; rotations can be sent to motors and
//! keep bones rigid.

use serde::{Deserialize, Serialize};

use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};
use crate::rotation::{Vector, add, subtract};
use crate::skeleton::Skeleton;

/// How joints are given to the decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Representation {
    /// The channels of the importer, untouched.
    #[default]
    AsIs,
    /// Root translation since frame 0, and every other joint relative to the root of its frame.
    Positions,
    /// Root translation since frame 0, and one local rotation a joint, joint 0 being the global orientation.
    Rotations,
}

/// Name of the root's translation group.
pub const ROOT_NAME: &str = "root";

/// Brings a clip set into its training representation.
///
/// `skeleton` replaces the set's own; its joint names become the group names.
///
/// # Errors
/// - `Positions` or `Rotations` of clips that hold anything but joint positions.
/// - A skeleton with another number of joints than the clips.
pub fn represent(
    mut clip_set: ClipSet,
    representation: Representation,
    skeleton: Option<Skeleton>,
) -> Result<ClipSet> {
    if skeleton.is_some() {
        clip_set.skeleton = skeleton;
    }
    if representation == Representation::AsIs {
        return Ok(clip_set);
    }
    check_joint_positions(&clip_set)?;
    match representation {
        Representation::Positions => Ok(positions(clip_set)),
        _ => Err(Error::bad_input(
            "representation",
            "rotations",
            "not built yet",
            "positions",
            "wait for the next commit",
        )),
    }
}

fn source_of(clip_set: &ClipSet) -> &std::path::Path {
    clip_set
        .clips
        .first()
        .map_or(std::path::Path::new("clips"), |clip| clip.source.as_path())
}

fn check_joint_positions(clip_set: &ClipSet) -> Result<()> {
    let groups = &clip_set.layout.groups;
    if let Some(group) = groups
        .iter()
        .find(|group| group.kind != GroupKind::Position)
    {
        return Err(Error::bad_input(
            source_of(clip_set),
            format!("channel group {}", group.name),
            group.kind.name(),
            "joint positions in every group",
            "use the representation as-is",
        ));
    }
    match &clip_set.skeleton {
        Some(skeleton) if skeleton.names.len() != groups.len() => Err(Error::bad_input(
            source_of(clip_set),
            "joints",
            groups.len(),
            format!("{}, as in the skeleton", skeleton.names.len()),
            "name the skeleton of these clips",
        )),
        _ => Ok(()),
    }
}

/// Absolute positions → root since frame 0, other joints relative to the root.
fn positions(mut clip_set: ClipSet) -> ClipSet {
    let unit = clip_set
        .layout
        .groups
        .first()
        .map_or(Unit::Metre, |group| group.unit);
    let names = joint_names(&clip_set);
    clip_set.layout = PoseLayout {
        groups: std::iter::once(root_group(unit))
            .chain(names.into_iter().skip(1).map(|name| Group {
                name,
                kind: GroupKind::Position,
                unit,
            }))
            .collect(),
    };
    let joint_count = clip_set.layout.groups.len();
    for clip in &mut clip_set.clips {
        relative_to_root(clip, joint_count);
    }
    clip_set
}

fn root_group(unit: Unit) -> Group {
    Group {
        name: ROOT_NAME.to_owned(),
        kind: GroupKind::Translation,
        unit,
    }
}

fn joint_names(clip_set: &ClipSet) -> Vec<String> {
    match &clip_set.skeleton {
        Some(skeleton) => skeleton.names.clone(),
        None => clip_set
            .layout
            .groups
            .iter()
            .map(|group| group.name.clone())
            .collect(),
    }
}

fn relative_to_root(clip: &mut Clip, joint_count: usize) {
    let Some(start) = clip.poses.first_chunk::<3>().map(|xyz| xyz.map(f64::from)) else {
        return;
    };
    for pose in clip.poses.chunks_exact_mut(3 * joint_count) {
        let root = vector(pose);
        for (joint, xyz) in pose.chunks_exact_mut(3).enumerate() {
            let origin = if joint == 0 { start } else { root };
            let relative = subtract(vector(xyz), origin).map(|element| element as f32);
            xyz.copy_from_slice(&relative);
        }
    }
}

/// First three channels as a vector.
fn vector(channels: &[f32]) -> Vector {
    std::array::from_fn(|axis| f64::from(channels[axis]))
}

/// Joint positions of one pose in the layout's own unit, for pictures and metrics. // (joint)
///
/// Understands absolute positions, [`Representation::Positions`] and [`Representation::Rotations`].
/// `None` where the layout is not a body: servos, a lone head, or rotations without a skeleton.
pub fn to_joint_positions(
    layout: &PoseLayout,
    pose: &[f32],
    skeleton: Option<&Skeleton>,
) -> Option<Vec<Vector>> {
    let kind_count = |kind| {
        layout
            .groups
            .iter()
            .filter(|group| group.kind == kind)
            .count()
    };
    let group_count = layout.groups.len();
    if kind_count(GroupKind::Position) == group_count && group_count > 0 {
        return Some(pose.chunks_exact(3).map(vector).collect());
    }
    let starts_at_root = layout.groups.first()?.kind == GroupKind::Translation;
    if starts_at_root && kind_count(GroupKind::Position) == group_count - 1 && group_count > 1 {
        let root = vector(pose);
        let others = pose
            .chunks_exact(3)
            .skip(1)
            .map(|xyz| add(root, vector(xyz)));
        return Some(std::iter::once(root).chain(others).collect());
    }
    let _ = skeleton;
    None
}
