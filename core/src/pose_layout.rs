//! What the channels of a pose mean: groups of scalars, rotations and translations.
//!
//! In:  the manifest of a blob (`blob.rs`).
//! Out: the order, width and unit of every channel of a pose.
//!
//! Why here: trainer and firmware must agree on one meaning of channel 17, so it is stored in the blob and defined
//! once. Source: Zhou et al., CVPR 2019 (6D rotations); pytorch3d's convention (first two rows of the matrix,
//! row-major).

use serde::{Deserialize, Serialize};

/// What one group of channels is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum GroupKind {
    /// One servo or any other single degree of freedom: 1 channel.
    Scalar,
    /// A joint's local rotation as the first two rows of its matrix, row-major: 6 channels.
    Rotation6d,
    /// The root's translation: 3 channels (x, y, z).
    Translation,
    /// A joint's position relative to the root: 3 channels (x, y, z).
    Position,
}

impl GroupKind {
    /// Every kind, in the order used by reports.
    pub const ALL: [Self; 4] = [Self::Scalar, Self::Rotation6d, Self::Translation, Self::Position];

    /// Number of channels that a group of this kind occupies.
    pub const fn channel_count(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Rotation6d => 6,
            Self::Translation | Self::Position => 3,
        }
    }

    /// The kind's name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Rotation6d => "rotation6d",
            Self::Translation => "translation",
            Self::Position => "position",
        }
    }
}

/// Unit of the channels of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Unit {
    /// A pure number: rotation matrix elements, normalised values.
    One,
    /// Angle in radians.
    Radian,
    /// Angle in degrees.
    Degree,
    /// Length in metres.
    Metre,
    /// Length in centimetres.
    Centimetre,
    /// Length in millimetres.
    Millimetre,
    /// Servo pulse width in microseconds.
    Microsecond,
}

impl Unit {
    /// The unit's suffix in names of files, columns and reports.
    pub const fn suffix(self) -> &'static str {
        match self {
            Self::One => "one",
            Self::Radian => "rad",
            Self::Degree => "deg",
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Microsecond => "us",
        }
    }
}
