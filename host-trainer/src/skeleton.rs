//! The joint tree of a body: names, parents and rest offsets as parallel arrays; parents precede children.
//!
//! In:  BVH hierarchies, the built-in `smpl24`, or a user's TOML.
//! Out: kinematics, pictures, and the blob.

use serde::{Deserialize, Serialize};

/// A joint tree; joint 0 is the root.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    /// Joint names. // (joint)
    pub names: Vec<String>,
    /// Index of the parent, smaller than the joint's own; `None` for the root alone. // (joint)
    pub parents: Vec<Option<usize>>,
    /// Offset from the parent at rest, in the unit of the layout's translation; zeros when only the tree is known. // (joint, xyz)
    pub offsets: Vec<[f32; 3]>,
}
