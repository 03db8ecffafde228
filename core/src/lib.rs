#![no_std]
//! Seeded motion for microcontrollers.

pub mod pose_layout;

pub use pose_layout::{GroupKind, Unit};
