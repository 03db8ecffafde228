//! Everything of karakuri that learns or measures: clip files in, blobs out.
//!
//! The modules stand in the order of the data's journey.

pub mod error;
pub mod atomic_file;
pub mod stdout;
pub mod table;
pub mod layout;
pub mod body;
pub mod clip;
pub mod character;
pub mod import;
pub mod inspect;
pub mod hold_out;
pub mod represent;
pub mod dataset;
pub mod config;
pub mod random;
pub mod simd;
pub mod float_model;
pub mod checkpoint;
pub mod classifier;
pub mod train;
pub mod mixture;
pub mod sampler;
pub mod quantize;
pub mod tune;
pub mod reconstruct;
pub mod calibration;
pub mod generate;
pub mod evaluate;
pub mod export;
pub mod keyframe;
pub mod bake;
pub mod plan;
pub mod perform;
pub mod picture;
pub mod reproduce;
pub mod commands;
