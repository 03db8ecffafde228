//! Station 2: standardised training pairs.
//!
//! In:  [`ClipSet`](crate::clip::ClipSet) in its training representation.
//! Out: [`Dataset`] to `train`; its [`DatasetDescription`] lives on in the checkpoint and in the blob.

use serde::{Deserialize, Serialize};

use crate::layout::PoseLayout;
use crate::skeleton::Skeleton;

/// What a checkpoint has to remember of its dataset: everything except the poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetDescription {
    /// Meaning of the channels.
    pub layout: PoseLayout,
    /// Poses per second.
    pub rate_hz: f64,
    /// Names of the actions, sorted; an action's index is its `ActionId`.
    pub actions: Vec<String>,
    /// The clips, in training order: row i of the code table belongs to clip i.
    pub clips: Vec<ClipDescription>,
    /// Per channel: value that becomes 0. // (channel)
    pub mean: Vec<f32>,
    /// Per channel: units per 1 of the standardised value; never 0. // (channel)
    pub scale: Vec<f32>,
    /// The joint tree, if any; offsets are the mean bone lengths over the clips.
    pub skeleton: Option<Skeleton>,
}

/// One clip of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClipDescription {
    /// The clip's name.
    pub name: String,
    /// Index into `actions`.
    pub action: usize,
    /// Number of poses.
    pub frame_count: usize,
}

/// Standardised poses of all clips.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Everything but the poses.
    pub description: DatasetDescription,
    /// `(value - mean) / scale`, clip after clip. // (frame of all clips, channel)
    pub poses: Vec<f32>,
    /// Row of each clip's first pose in `poses`. // (clip)
    pub first_rows: Vec<usize>,
}
