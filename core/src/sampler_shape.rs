//! Which tables a sampler has, and how large they are.
//!
//! In:  a field of the manifest.
//! Out: [`SamplerShape`], to `manifest.rs` and `sampler.rs`.

use serde::Serialize;

/// How the codes of a motion are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum SamplerKind {
    /// A training clip's own code, moved towards a neighbour's, plus noise of one shared σ.
    ClipCodes,
    /// A Gaussian mixture with diagonal covariances.
    DiagonalMixture,
    /// As `ClipCodes`, but one of the clips of the action that are nearest in length; every number has as many bits
    /// as its column needs.
    NearestClips {
        /// Clips that a motion is drawn from, all that the action has where it has fewer.
        clip_count: u16,
        /// Bytes of a clip's code.
        row_bytes: u16,
    },
}

impl SamplerKind {
    /// The name in commands and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ClipCodes => "clip codes",
            Self::DiagonalMixture => "diagonal mixture",
            Self::NearestClips { .. } => "nearest clips",
        }
    }
}

/// Sizes of the sampler's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SamplerShape {
    /// What a component is.
    pub kind: SamplerKind,
    /// Stored means: clips, or Gaussians.
    pub component_count: u32,
    /// Entries of all intervals together; `NearestClips` has none, members of its intervals are components.
    pub member_count: u32,
    /// Length intervals of all actions together; `NearestClips`: one an action.
    pub interval_count: u16,
    /// Clips: largest step towards a neighbour, Q0.16.
    pub step_max_q16: u32,
}
