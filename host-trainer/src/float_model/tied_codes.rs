//! Layer 1, gates and phases for codes that are added, and for actions without a code.
//!
//! In:  a model at its start, or the gradient of a layer that sees the code.
//! Out: the same, with the halves for β and α alike, or without the half for α.
//!
//! Why here: W·(β + α) = W·β + W·α. With the same weights twice a sum of codes is a concatenation, so neither the
//! passes nor the blob has to know of it. Equal starts and equal gradients keep the halves equal to the last bit.

use super::{DenseLayer, FloatModel};

/// Gives α the start weights of β; the spread is that of a layer that sees the sum only.
pub fn tie_start(model: &mut FloatModel) {
    let dimension_count = model.sequence_code_count;
    let first = &mut model.layers[0];
    let input_count = first.input_count as f32;
    let spread = (input_count / (input_count - dimension_count as f32)).sqrt();
    for row in first.weights.chunks_exact_mut(first.input_count) {
        row.copy_within(..dimension_count, dimension_count);
        row.iter_mut().for_each(|weight| *weight *= spread);
    }
    first.bias.iter_mut().for_each(|bias| *bias *= spread);
    if let Some(layer) = &mut model.modulation {
        let rows = layer.weights.chunks_exact_mut(layer.input_count);
        rows.for_each(|row| row.copy_within(..dimension_count, dimension_count));
    }
}

/// Turns the gradients by both halves into that by the weights that they share.
///
/// # Shapes
/// `gradient` (out, β then α then τ), β and α of `dimension_count` each
pub fn tie_gradient(gradient: &mut DenseLayer, dimension_count: usize) {
    for row in gradient.weights.chunks_exact_mut(gradient.input_count) {
        let (by_sequence, others) = row.split_at_mut(dimension_count);
        for (sequence, action) in by_sequence.iter_mut().zip(others) {
            *sequence += *action;
            *action = *sequence;
        }
    }
}

/// Takes α out of the model: its code stays 0, so its weights never get a gradient.
pub fn clear_action_columns(model: &mut FloatModel) {
    let columns = model.sequence_code_count..model.code_count();
    for layer in model.layers.iter_mut().take(1).chain(&mut model.modulation) {
        for row in layer.weights.chunks_exact_mut(layer.input_count) {
            row[columns.clone()].fill(0.0);
        }
    }
}
