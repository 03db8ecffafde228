//! Station 1: one recorded motion.
//!
//! In:  a user's file, through `import`.
//! Out: [`ClipSet`] to `represent` and `dataset`.

use std::path::PathBuf;

use crate::body::skeleton::Skeleton;
use crate::layout::PoseLayout;

/// Timed poses of one recording, at the fixed rate of its set.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Unique name within the set; the file stem.
    pub name: String,
    /// Label of the motion; empty when the source names none.
    pub action: String,
    /// Where it came from; for error messages.
    pub source: PathBuf,
    /// Channel values in channel units. // (frame, channel)
    pub poses: Vec<f32>,
}

impl Clip {
    /// Number of poses.
    pub fn frame_count(&self, layout: &PoseLayout) -> usize {
        self.poses.len() / layout.channel_count().max(1)
    }
}

/// Clips that share one layout and one rate.
#[derive(Clone, Debug, PartialEq)]
pub struct ClipSet {
    /// Meaning of the channels.
    pub layout: PoseLayout,
    /// Poses per second.
    pub rate_hz: f64,
    /// The joint tree, where the source names one.
    pub skeleton: Option<Skeleton>,
    /// The clips, sorted by name.
    pub clips: Vec<Clip>,
    /// What the importer had to say: resampled, rebased, skipped, with the file's name.
    pub remarks: Vec<String>,
}
