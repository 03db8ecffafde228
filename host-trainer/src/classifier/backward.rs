//! The backward pass of one recurrent layer: the loss's gradient by hidden states → gradients by weights and inputs.
//!
//! In:  the [`LayerTrace`] of the forward pass; the gradient by every state, as far as later layers know it.
//! Out: the gradient by both halves of the weights, and by the inputs.
//!
//! Why here: backpropagation through time. Only the way back through the states has to go frame by frame; the weights'
//! gradients are one product each over all frames.
//!
//! Source: derivatives of the formula in `recurrent.rs`; checked against finite differences in `lesson.rs`.

use faer::Accum;

use super::recurrent::{GATE_COUNT, LayerTrace, RecurrentLayer};
use crate::float_model::DenseLayer;
use crate::float_model::forward::{matrix, matrix_mut, multiply};
use crate::simd::{self, vectorized};

/// Gradients by everything inside a layer.
#[derive(Clone, Debug, Default)]
pub struct LayerDeltas {
    /// By the hidden states, as `LayerTrace::hidden`. // (frame + 1, motion, unit)
    pub states: Vec<f32>,
    /// By what the inputs add to the gates. // (frame, motion, 3 · unit)
    pub input: Vec<f32>,
    /// By what the states add to the gates. // (frame, motion, 3 · unit)
    recurrent: Vec<f32>,
}

impl RecurrentLayer<'_> {
    /// Goes back through all frames; `deltas.states` holds the later layers' part and is completed.
    pub fn backward(&self, trace: &LayerTrace, motion_count: usize, deltas: &mut LayerDeltas) {
        let (unit_count, width) = (self.unit_count(), GATE_COUNT * self.unit_count());
        deltas.input.resize(trace.gates.len(), 0.0);
        deltas.recurrent.resize(trace.gates.len(), 0.0);
        let frame_len = motion_count * unit_count;
        for frame in (0..trace.gates.len() / (motion_count * width)).rev() {
            let (before, after) = deltas.states.split_at_mut((frame + 1) * frame_len);
            let before = &mut before[frame * frame_len..];
            for motion in 0..motion_count {
                let row = frame * motion_count + motion;
                step_row(&mut Row {
                    gates: &trace.gates[row * width..][..width],
                    candidates: &trace.candidates[row * unit_count..][..unit_count],
                    state_before: &trace.hidden[row * unit_count..][..unit_count],
                    delta: &after[motion * unit_count..][..unit_count],
                    delta_before: &mut before[motion * unit_count..][..unit_count],
                    input: &mut deltas.input[row * width..][..width],
                    recurrent: &mut deltas.recurrent[row * width..][..width],
                });
            }
            let recurrent =
                &deltas.recurrent[frame * motion_count * width..][..motion_count * width];
            let weights = matrix(&self.recurrent.weights, unit_count);
            multiply(matrix_mut(before, unit_count), Accum::Add, matrix(recurrent, width), weights);
        }
    }

    /// The gradient by the inputs of the layer, after [`RecurrentLayer::backward`]. // (frame, motion, input)
    pub fn input_gradient(&self, deltas: &LayerDeltas, target: &mut [f32]) {
        let weights = matrix(&self.input.weights, self.input.input_count);
        let target = matrix_mut(target, self.input.input_count);
        let deltas = matrix(&deltas.input, self.input.output_count);
        multiply(target, Accum::Replace, deltas, weights);
    }
}

impl LayerDeltas {
    /// The gradient by the weights: input half, recurrent half.
    ///
    /// # Shapes
    /// `inputs` (frame, motion, input)
    pub fn weight_gradients(&self, inputs: &[f32], trace: &LayerTrace, halves: &mut [DenseLayer]) {
        let row_count = self.input.len() / halves[0].output_count;
        let states = &trace.hidden[..row_count * halves[1].input_count];
        dense_gradient(&self.input, inputs, &mut halves[0]);
        dense_gradient(&self.recurrent, states, &mut halves[1]);
    }
}

/// `deltasᵀ · inputs`, and the sum of the rows of `deltas`.
pub fn dense_gradient(deltas: &[f32], inputs: &[f32], gradient: &mut DenseLayer) {
    let (input_count, output_count) = (gradient.input_count, gradient.output_count);
    let target = matrix_mut(&mut gradient.weights, input_count);
    let rows = matrix(deltas, output_count).transpose();
    multiply(target, Accum::Replace, rows, matrix(inputs, input_count));
    gradient.bias.fill(0.0);
    deltas.chunks_exact(output_count).for_each(|row| simd::add(&mut gradient.bias, row));
}

/// One motion at one frame.
struct Row<'a> {
    gates: &'a [f32],
    candidates: &'a [f32],
    state_before: &'a [f32],
    delta: &'a [f32],
    delta_before: &'a mut [f32],
    input: &'a mut [f32],
    recurrent: &'a mut [f32],
}

fn step_row(row: &mut Row<'_>) {
    let count = row.delta.len();
    let (reset, others) = row.gates.split_at(count);
    let (update, new) = others.split_at(count);
    let (by_reset, others) = row.input.split_at_mut(count);
    let (by_update, by_new) = others.split_at_mut(count);
    let states = row.state_before.iter().zip(row.delta).zip(&mut *row.delta_before);
    let gates = reset.iter().zip(update).zip(new).zip(row.candidates);
    let targets = by_reset.iter_mut().zip(by_update).zip(&mut *by_new);
    let by_candidate = &mut row.recurrent[2 * count..];
    vectorized(|| {
        for ((((state, delta), delta_before), (((r, z), n), candidate)), (((dr, dz), dn), dc)) in
            states.zip(gates).zip(targets.zip(by_candidate))
        {
            *delta_before += delta * z;
            *dn = delta * (1.0 - z) * (1.0 - n * n);
            *dz = delta * (state - n) * z * (1.0 - z);
            *dr = *dn * candidate * r * (1.0 - r);
            *dc = *dn * r;
        }
    });
    row.recurrent[..2 * count].copy_from_slice(&row.input[..2 * count]);
}
