//! Everything of karakuri that learns or measures: clip files in, blobs out.
//!
//! The modules stand in the order of the data's journey.

pub mod error;
pub mod layout;
pub mod rotation;
pub mod skeleton;
pub mod infer_skeleton;
pub mod kinematics;
pub mod body;
pub mod clip;
pub mod represent;
pub mod represent_rotations;
pub mod dataset;
pub mod float_model;
pub mod checkpoint;
pub mod bvh_export;
pub mod export;
pub mod svg;
pub mod picture;
pub mod view;
pub mod stick_figures;
pub mod curves;
