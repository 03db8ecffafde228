//! Everything of karakuri that learns or measures: clip files in, blobs out.
//!
//! The modules stand in the order of the data's journey.

pub mod error;
pub mod layout;
pub mod skeleton;
pub mod clip;
pub mod dataset;
pub mod config;
pub mod random;
pub mod atomic_file;
pub mod float_model;
pub mod optimizer;
pub mod schedule;
pub mod metrics;
pub mod checkpoint;
pub mod train;
pub mod commands;
