//! What a device makes of codes, time and weights, in real numbers.
//!
//! In:  a float model, the number format, how its activations are stored.
//! Out: inputs of layer 1 and an effective model, rounded as the device rounds them, to `tune/step.rs`.
//!
//! Why here: rounding is `core`'s and the quantiser's; this file holds no arithmetic of its own but the way back to
//! real numbers.

use karakuri::{FramePosition, NumberFormat, sinusoids_q15};

use crate::dataset::DatasetDescription;
use crate::float_model::FloatModel;
use crate::float_model::activation::ActivationGrid;
use crate::quantize::effective::{WeightFormat, effective_model};
use crate::quantize::layer::InputScale;
use crate::quantize::{frequency_step, input_scales};

/// How a device of one number format stores the numbers of one model.
#[derive(Clone, Debug)]
pub struct Device {
    format: NumberFormat,
    weights: WeightFormat,
    /// Code half, time half, hidden layers.
    inputs: Vec<InputScale>,
    code_one: f32,
    frequency_steps: Vec<u32>,
}

impl Device {
    /// `hidden` is how the hidden layers' activations are stored.
    pub fn new(
        format: NumberFormat,
        weights: WeightFormat,
        model: &FloatModel,
        hidden: &[InputScale],
        code_fraction_bits: u8,
    ) -> Self {
        Self {
            format,
            weights,
            inputs: input_scales(hidden, format, code_fraction_bits),
            code_one: f32::from(1u16 << code_fraction_bits),
            frequency_steps: model.frequencies_rad.iter().map(|&w| frequency_step(w)).collect(),
        }
    }

    /// The weights that a blob would hold, as real numbers.
    pub fn effective_model(&self, model: &FloatModel, dataset: &DatasetDescription) -> FloatModel {
        effective_model(model, dataset, &self.inputs, self.weights)
    }

    /// Where the activations of every hidden layer are rounded to.
    pub fn grids(&self) -> Vec<ActivationGrid> {
        let range = self.format.activation_range();
        let hidden = self.inputs.iter().skip(2);
        hidden.map(|input| ActivationGrid::new(input.scale, input.zero_point, range)).collect()
    }

    /// Codes rounded in place.
    pub fn round_codes(&self, codes: &mut [f32]) {
        for value in codes {
            let stored = (*value * self.code_one).round().clamp(-32_768.0, 32_767.0);
            *value = stored / self.code_one;
        }
    }

    /// Writes the sinusoids of a frame. // (sinusoid)
    pub fn embed_time(&self, frame: usize, tau: &mut [f32]) {
        let one = i32::from(self.format.sinusoid_one());
        for (pair, &step) in tau.chunks_exact_mut(2).zip(&self.frequency_steps) {
            let sinusoids = sinusoids_q15(FramePosition::from_frames(frame as u32), step);
            for (value, q15) in pair.iter_mut().zip(sinusoids) {
                *value = self.stored_sinusoid(q15) as f32 / one as f32;
            }
        }
    }

    /// As `core`'s `Integer::sinusoid`.
    fn stored_sinusoid(&self, q15: i16) -> i32 {
        let one = i32::from(self.format.sinusoid_one());
        if one == 32_767 { q15.into() } else { (i32::from(q15) * one + (1 << 14)) >> 15 }
    }
}
