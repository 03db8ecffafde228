//! One layer of gated recurrent units over all frames of a few motions.
//!
//! In:  the layer's inputs and the hidden state before frame 0.
//! Out: the hidden state after every frame, and in [`LayerTrace`] what a backward pass needs.
//!
//! Why here: buffers are (frame, motion, unit), so that one frame of all motions is one matrix. The input's half of the
//! gates is one product over all frames; only the recurrent half has to go frame by frame.
//!
//! Source: Cho et al. 2014, with the reset gate after the product, as PyTorch's `nn.GRU` has it:
//! n = tanh(W_n x + b_n + r ∘ (U_n h + c_n)), h' = (1 − z) ∘ n + z ∘ h; rows stacked r, z, n.

use faer::Accum;

use super::gate::{sigmoid, tanh};
use crate::float_model::DenseLayer;
use crate::float_model::forward::{matrix, matrix_mut, multiply};
use crate::simd::vectorized;

/// Gates of a unit: reset, update, new.
pub const GATE_COUNT: usize = 3;

/// The weights of one layer.
#[derive(Clone, Copy, Debug)]
pub struct RecurrentLayer<'a> {
    /// Inputs to gates. // (3 · unit, input)
    pub input: &'a DenseLayer,
    /// Hidden state before the frame to gates. // (3 · unit, unit)
    pub recurrent: &'a DenseLayer,
}

/// Everything that a layer computed over the frames of some motions.
#[derive(Clone, Debug, Default)]
pub struct LayerTrace {
    /// r, z and n. // (frame, motion, 3 · unit)
    pub gates: Vec<f32>,
    /// U_n h + c_n, which the reset gate multiplies. // (frame, motion, unit)
    pub candidates: Vec<f32>,
    /// Hidden state before frame 0, then after every frame. // (frame + 1, motion, unit)
    pub hidden: Vec<f32>,
    /// The recurrent half of one frame's gates. // (motion, 3 · unit)
    products: Vec<f32>,
}

impl RecurrentLayer<'_> {
    /// Number of units.
    pub const fn unit_count(&self) -> usize {
        self.recurrent.input_count
    }

    /// Runs the layer over all frames of some motions.
    ///
    /// # Shapes
    /// `inputs` (frame, motion, input) · `start` (motion, unit)
    pub fn forward(&self, inputs: &[f32], start: &[f32], trace: &mut LayerTrace) {
        let unit_count = self.unit_count();
        let motion_count = start.len() / unit_count;
        let row_count = inputs.len() / self.input.input_count;
        trace.gates.resize(row_count * GATE_COUNT * unit_count, 0.0);
        trace.candidates.resize(row_count * unit_count, 0.0);
        trace.hidden.resize(start.len() + row_count * unit_count, 0.0);
        trace.products.resize(motion_count * GATE_COUNT * unit_count, 0.0);
        trace.hidden[..start.len()].copy_from_slice(start);
        let weights = matrix(&self.input.weights, self.input.input_count).transpose();
        let gates = matrix_mut(&mut trace.gates, GATE_COUNT * unit_count);
        multiply(gates, Accum::Replace, matrix(inputs, self.input.input_count), weights);
        for frame in 0..row_count / motion_count {
            self.step(frame, motion_count, trace);
        }
    }

    /// From the hidden state before `frame` to the one after it.
    fn step(&self, frame: usize, motion_count: usize, trace: &mut LayerTrace) {
        let unit_count = self.unit_count();
        let width = GATE_COUNT * unit_count;
        let states = &mut trace.hidden[frame * motion_count * unit_count..];
        let (before, after) = states.split_at_mut(motion_count * unit_count);
        let weights = matrix(&self.recurrent.weights, unit_count).transpose();
        let products = matrix_mut(&mut trace.products, width);
        multiply(products, Accum::Replace, matrix(before, unit_count), weights);
        for motion in 0..motion_count {
            let row = frame * motion_count + motion;
            self.finish_row(
                &mut trace.gates[row * width..][..width],
                &trace.products[motion * width..][..width],
                &mut trace.candidates[row * unit_count..][..unit_count],
                &before[motion * unit_count..][..unit_count],
                &mut after[motion * unit_count..][..unit_count],
            );
        }
    }

    /// Gates and new state of one motion at one frame; `gates` come as the input's products.
    fn finish_row(
        &self,
        gates: &mut [f32],
        products: &[f32],
        candidates: &mut [f32],
        before: &[f32],
        after: &mut [f32],
    ) {
        let count = before.len();
        let (input_bias, bias) = (&self.input.bias, &self.recurrent.bias);
        let (reset_update, new) = gates.split_at_mut(2 * count);
        vectorized(|| {
            let biases = input_bias.iter().zip(bias);
            for ((gate, product), (b, c)) in reset_update.iter_mut().zip(products).zip(biases) {
                *gate = sigmoid(*gate + product + b + c);
            }
        });
        vectorized(|| {
            let products = products[2 * count..].iter().zip(&bias[2 * count..]);
            for (candidate, (product, c)) in candidates.iter_mut().zip(products) {
                *candidate = product + c;
            }
            let (reset, update) = reset_update.split_at(count);
            let gates = reset.iter().zip(update).zip(&*candidates);
            let inputs = new.iter_mut().zip(&input_bias[2 * count..]);
            let states = before.iter().zip(after);
            for (((new, b), ((r, z), candidate)), (before, after)) in inputs.zip(gates).zip(states)
            {
                *new = tanh(*new + b + r * candidate);
                *after = (1.0 - z) * *new + z * before;
            }
        });
    }
}
