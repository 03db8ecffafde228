#![no_std]
#![doc = include_str!("../README.md")]
#![deny(unsafe_code, missing_docs)]
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::panic, clippy::expect_used, clippy::unwrap_used)
)]

#[cfg(test)]
extern crate std;

// In the order of the data's journey: bytes, model, code, pose, servos; what they share comes first.
pub mod limits;
pub mod pose_layout;
mod error;
mod little_endian;
mod crc32;
mod requantize;
mod sine;
mod elu;
pub mod random;
pub mod manifest;
mod code_half;
pub mod blob;
mod descriptions;
pub mod packing;
pub mod kernel;
mod layer;
mod manifest_check;
mod model;
mod code;
mod dials;
mod length_interval;
mod variety;
mod sampler;
mod sampler_shape;
mod time_embedding;
mod workspace;
mod integer;
#[cfg(feature = "f16")]
mod half_float;
mod decoder;
mod pair_decoder;
mod pose;
mod track;
mod inertia;
mod overlay;
mod voice;
mod unit_vector;
mod arc_tangent;
mod rotation;
mod fault;
mod servo_map;
pub mod servo_records;
mod servo_limiter;
mod goal_path;
mod soft_start;
mod servo_command;
mod servo;
mod intent;
mod idle;
mod player;
pub mod link;
pub mod output;
#[cfg(test)]
mod deviation;
#[cfg(test)]
mod specimen;

pub use code::Code;
pub use decoder::Decoder;
#[doc(hidden)]
pub use decoder::Stage;
pub use dials::Dials;
pub use error::{BlobError, PlayError, SampleError, ServoError};
pub use fault::Fault;
pub use intent::{Event, Intent, Marker};
pub use manifest::NumberFormat;
pub use model::{ActionId, Model};
pub use overlay::{ChannelMask, Overlay, OverlayKind};
pub use pair_decoder::PairDecoder;
pub use player::{Player, PlayerState};
pub use pose::Pose;
pub use pose_layout::{GroupKind, Unit};
pub use random::Pcg32;
pub use requantize::Requantizer;
pub use rotation::{Axis, AxisOrder, Rotation};
pub use servo::ServoStage;
pub use servo_command::ServoCommand;
pub use servo_map::{PULSE_US_MAX, ServoLimits, ServoMap};
pub use time_embedding::{FramePosition, stored_sinusoids};
pub use voice::Voice;
pub use workspace::{PairWorkspace, Workspace};
