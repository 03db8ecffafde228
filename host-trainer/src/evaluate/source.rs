//! Where generated motions come from: the float model or a blob, one seam for both.
//!
//! In:  [`MotionRequest`]s: action, length, window, seed.
//! Out: joint positions in metres, or channels where there is no body, of the window's frames only.
//!
//! Why here: whatever makes motions is measured by the same rule. A blob is decoded by `karakuri` itself, so its row is
//! the device's. The float decoder takes its codes from any [`CodeSampler`], so that samplers are compared on one
//! decoder.

mod blob;
mod float;

use rand_chacha::ChaCha8Rng;
use serde::Serialize;

pub use blob::BlobSource;
pub use float::{ClipCodes, FloatSource};

use super::crop::Window;
use crate::classifier::example::Input;
use crate::error::Result;
use crate::mixture::set::MixtureSet;

/// One motion to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotionRequest {
    /// Index into [`MotionSource::actions`].
    pub action: usize,
    /// Length of the whole motion.
    pub frame_count: usize,
    /// The frames that are wanted.
    pub window: Window,
    /// Of this motion's own random stream.
    pub seed: u64,
}

/// Makes motions.
pub trait MotionSource: Sync {
    /// What it is, for the report.
    fn description(&self) -> SourceDescription;

    /// Names of its actions.
    fn actions(&self) -> &[String];

    /// What its poses are.
    fn input(&self) -> Input;

    /// Numbers of a pose: joints times 3, or channels.
    fn channel_count(&self) -> usize;

    /// Poses per second.
    fn rate_hz(&self) -> f64;

    /// Joint positions in metres, or channels; the same requests give the same bits with any number of threads. //
    /// (motion), (frame of the window, channel)
    ///
    /// # Errors
    /// A length that the source was not trained for.
    fn poses(&self, requests: &[MotionRequest]) -> Result<Vec<Vec<f32>>>;
}

/// Where a row's motions come from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SourceDescription {
    /// Path of the run or blob.
    pub name: String,
    /// `float`, or the blob's number format.
    pub format: String,
    /// How codes are drawn.
    pub sampler: String,
    /// SHA-256 of the training configuration, hexadecimal.
    pub config_hash: String,
    /// Seed of the training.
    pub seed: u64,
    /// SHA-256 of the checkpoint or the blob, hexadecimal.
    pub file_hash: String,
    /// Length of the blob; `None` for a float run.
    pub bytes: Option<usize>,
}

/// Draws sequence codes.
pub trait CodeSampler: Sync {
    /// What it is, for the report.
    fn name(&self) -> String;

    /// The sequence code β of a new motion. // (dimension)
    ///
    /// # Errors
    /// A length that no clip of the action has.
    fn sample(
        &self,
        action: usize,
        frame_count: usize,
        random: &mut ChaCha8Rng,
    ) -> Result<Vec<f32>>;
}

impl CodeSampler for MixtureSet {
    fn name(&self) -> String {
        let components = self.intervals.iter().map(|interval| interval.mixture.components.len());
        let (intervals, components) = (self.intervals.len(), components.sum::<usize>());
        format!("{intervals} mixtures, {components} components")
    }

    fn sample(
        &self,
        action: usize,
        frame_count: usize,
        random: &mut ChaCha8Rng,
    ) -> Result<Vec<f32>> {
        let code = Self::sample(self, action, frame_count, random)?;
        Ok(code.into_iter().map(|value| value as f32).collect())
    }
}
