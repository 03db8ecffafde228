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
pub mod import;
pub mod inspect;
pub mod represent;
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
pub mod interval;
pub mod k_means;
pub mod expectation_maximization;
pub mod mixture;
pub mod mixture_set;
pub mod collapse;
pub mod fit;
pub mod mixture_file;
pub mod calibrate;
pub mod quantize_layer;
pub mod quantize_sampler;
pub mod quantize;
pub mod table;
pub mod inspect_blob;
pub mod reconstruct;
pub mod generate;
pub mod export;
pub mod svg;
pub mod stick_figures;
pub mod curves;
pub mod picture;
pub mod commands;
