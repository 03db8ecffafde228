//! The host's owned form of the pose layout.
//!
//! In:  importers name their channels.
//! Out: the layout of every [`Clip`](crate::clip::Clip), of the dataset and, through `quantize`, of the blob.
//!
//! Source: `karakuri::pose_layout` owns the meaning of kinds and units.

use std::ops::Range;

pub use karakuri::{GroupKind, Unit};
use serde::{Deserialize, Serialize};

/// One named group of channels.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Group {
    /// Unique name: a joint or a servo.
    pub name: String,
    /// What the channels are.
    pub kind: GroupKind,
    /// Unit of every channel of the group.
    pub unit: Unit,
}

/// All groups of a pose, in channel order.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PoseLayout {
    /// The groups.
    pub groups: Vec<Group>,
}

impl PoseLayout {
    /// Number of channels of one pose.
    pub fn channel_count(&self) -> usize {
        self.groups.iter().map(|group| group.kind.channel_count()).sum()
    }

    /// Every group with the channels that it occupies.
    pub fn ranges(&self) -> impl Iterator<Item = (&Group, Range<usize>)> {
        self.groups.iter().scan(0, |start, group| {
            let range = *start..*start + group.kind.channel_count();
            *start = range.end;
            Some((group, range))
        })
    }

    /// One name a channel: `jaw_deg`, `head_x_m`, `neck_r01`.
    pub fn channel_names(&self) -> Vec<String> {
        self.groups.iter().flat_map(channel_names_of_group).collect()
    }
}

fn channel_names_of_group(group: &Group) -> Vec<String> {
    let (name, suffix) = (&group.name, group.unit.suffix());
    match group.kind {
        GroupKind::Scalar => vec![format!("{name}_{suffix}")],
        GroupKind::Translation | GroupKind::Position => {
            ["x", "y", "z"].iter().map(|axis| format!("{name}_{axis}_{suffix}")).collect()
        }
        GroupKind::Rotation6d => ["r00", "r01", "r02", "r10", "r11", "r12"]
            .iter()
            .map(|element| format!("{name}_{element}"))
            .collect(),
    }
}
