//! What a device makes of codes, time and weights, in real numbers.
//!
//! In:  a float model, the number format, how its activations are stored.
//! Out: inputs of layer 1 and an effective model, rounded as the device rounds them, to `tune/step.rs`.
//!
//! Why here: rounding is `core`'s and the quantiser's; this file holds no arithmetic of its own but the way back to
//! real numbers.

use karakuri::manifest::{Packing, WeightFormat};
use karakuri::{FramePosition, NumberFormat, stored_sinusoids};

use crate::dataset::DatasetDescription;
use crate::float_model::FloatModel;
use crate::float_model::activation::ActivationGrid;
use crate::quantize::effective::effective_model;
use crate::quantize::frequency_step;
use crate::quantize::integer_layers::IntegerInput;
use crate::quantize::layer::InputScale;
use crate::quantize::split::split_layers;

/// How a device of one number format stores the numbers of one model.
#[derive(Clone, Debug)]
pub struct Device {
    format: NumberFormat,
    /// Code half, time half, the others.
    weights: Vec<WeightFormat>,
    hidden: Vec<InputScale>,
    code_fraction_bits: u8,
    frequency_steps: Vec<u32>,
}

impl Device {
    /// `weights` is how each layer's weights are stored, `hidden` how the hidden layers' activations are.
    pub fn new(
        format: NumberFormat,
        model: &FloatModel,
        weights: Vec<WeightFormat>,
        hidden: Vec<InputScale>,
        code_fraction_bits: u8,
    ) -> Self {
        Self {
            format,
            weights,
            hidden,
            code_fraction_bits,
            frequency_steps: model.frequencies_rad.iter().map(|&w| frequency_step(w)).collect(),
        }
    }

    /// The weights that a blob would hold, as real numbers.
    pub fn effective_model(&self, model: &FloatModel, dataset: &DatasetDescription) -> FloatModel {
        let stored = IntegerInput {
            layers: &split_layers(model, dataset),
            hidden: &self.hidden,
            // What bias correction would do is learned.
            means: &[],
            format: self.format,
            packing: Packing::Tiles,
            weights: &self.weights,
            code_fraction_bits: self.code_fraction_bits,
        };
        effective_model(model, dataset, stored)
    }

    /// Where the activations of every hidden layer are rounded to.
    pub fn grids(&self) -> Vec<ActivationGrid> {
        let range = self.format.activation_range();
        let hidden = self.hidden.iter();
        hidden.map(|input| ActivationGrid::new(input.scale, input.zero_point, range)).collect()
    }

    /// Codes rounded in place.
    pub fn round_codes(&self, codes: &mut [f32]) {
        let one = f32::from(1u16 << self.code_fraction_bits);
        for value in codes {
            *value = (*value * one).round().clamp(-32_768.0, 32_767.0) / one;
        }
    }

    /// Writes the sinusoids of a frame. // (sinusoid)
    pub fn embed_time(&self, frame: usize, tau: &mut [f32]) {
        let one = f32::from(self.format.sinusoid_one());
        let position = FramePosition::from_frames(frame as u32);
        for (pair, &step) in tau.chunks_exact_mut(2).zip(&self.frequency_steps) {
            let stored = stored_sinusoids(self.format, position, step);
            pair.copy_from_slice(&stored.map(|value| value as f32 / one));
        }
    }
}
