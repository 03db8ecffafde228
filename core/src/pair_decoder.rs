//! Two poses for the price of 1.6 (`w8a16`) to 1.8 (`w8a8`): each weight is loaded once for both.
//!
//! Why here: the temporal embedding is known ahead, so a player that may lag by one frame can decode two at a time. It
//! saves instructions and half of the reads from flash where there is DSP; the other cores go over the weights twice.

use crate::code::Code;
use crate::error::BlobError;
use crate::integer;
use crate::manifest::NumberFormat;
use crate::model::Model;
use crate::pose::Pose;
use crate::time_embedding::FramePosition;
use crate::workspace::{Buffers, PairWorkspace};

/// A model with a workspace for two frames; models with tiles of 8-bit weights in every layer.
#[derive(Debug)]
pub struct PairDecoder<'m, 'w> {
    model: &'m Model<'m>,
    buffers: Buffers<'w, 2>,
}

impl<'m, 'w> PairDecoder<'m, 'w> {
    /// Binds a model to a workspace. Call [`start`](Self::start) before decoding.
    ///
    /// # Errors
    /// * [`BlobError::WorkspaceTooSmall`]: `WIDTH` is less than `Model::workspace_width`.
    /// * [`BlobError::NoPairKernel`]: a layer with 4-bit or binary16 weights, or packed in rows; use a
    ///   [`Decoder`](crate::Decoder) twice.
    pub fn new<const WIDTH: usize>(
        model: &'m Model<'m>,
        workspace: &'w mut PairWorkspace<WIDTH>,
    ) -> Result<Self, BlobError> {
        model.check_width(WIDTH)?;
        if model.number_format() == NumberFormat::F16 || !model.has_pair_kernels() {
            return Err(BlobError::NoPairKernel(model.number_format()));
        }
        Ok(Self { model, buffers: workspace.buffers() })
    }

    /// Begins a motion: computes the code half of layer 1.
    pub fn start(&mut self, code: &Code) {
        integer::fold(self.model, &mut self.buffers, code);
    }

    /// Decodes two poses of the motion that was started, the same bits as two calls of
    /// [`Decoder::decode`](crate::Decoder::decode).
    ///
    /// # Units and formats
    /// `positions`: frames, Q16.16 · `poses`: channel units, Q15.16
    ///
    /// # Cost
    /// On Cortex-M4, paper size, per frame: 0.89 of a single pose's instructions with `w8a8`, 0.80 with `w8a16`.
    pub fn decode(&mut self, positions: [FramePosition; 2], poses: &mut [Pose; 2]) {
        integer::decode(self.model, &mut self.buffers, positions, poses.each_mut(), &mut |_| ());
    }
}
