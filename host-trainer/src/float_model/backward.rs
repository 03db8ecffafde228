//! The backward pass: the loss's gradient by the poses → gradients by weights, biases and codes.
//!
//! In:  the activations that `forward` left in the [`Workspace`], and the poses' gradient in its last delta.
//! Out: the decoder's gradient, layer by layer, and the gradient by every code.
//!
//! Why here: layer 1's deltas are summed per code and per moment first, so its products have as few rows as the forward
//! pass. The time embedding is fixed and needs no gradient.

use faer::{Accum, MatRef, Par};

use super::activation::elu_slope;
use super::forward::{Rows, Workspace, for_each_row, matrix, matrix_mut, multiply};
use super::{DenseLayer, FloatModel};

/// Which gradients a backward pass computes.
#[derive(Debug)]
pub struct Wanted<'a> {
    /// The gradient by weights and biases. // (layer)
    pub decoder: Option<&'a mut [DenseLayer]>,
    /// Whether the decoder's gradient is replaced or added to.
    pub accumulate: Accum,
    /// Replaced: the gradient by β and α. // (code, dimension)
    pub codes: Option<&'a mut [f32]>,
}

impl FloatModel {
    /// Computes the wanted gradients of the batch that `forward` just decoded.
    pub fn backward(
        &self,
        rows: &Rows<'_>,
        par: Par,
        workspace: &mut Workspace,
        mut wanted: Wanted<'_>,
    ) {
        let row_count = rows.code_of_row.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1).rev() {
            let (before, after) = workspace.deltas.split_at_mut(index);
            let delta = &after[0][..row_count * layer.output_count];
            let input = &workspace.activations[index - 1][..row_count * layer.input_count];
            if let Some(gradient) = wanted.decoder.as_deref_mut() {
                let gradient = &mut gradient[index];
                let input = matrix(input, layer.input_count);
                layer_gradient(gradient, 0, delta, input, wanted.accumulate, par);
                sum_columns(&mut gradient.bias, delta, wanted.accumulate);
            }
            let input_delta = &mut before[index - 1][..row_count * layer.input_count];
            multiply(
                matrix_mut(input_delta, layer.input_count),
                Accum::Replace,
                matrix(delta, layer.output_count),
                layer.weight_matrix(),
                par,
            );
            for_each_row(input_delta, layer.input_count, |row_index, row| {
                let outputs = &input[row_index * layer.input_count..][..layer.input_count];
                for (delta, output) in row.iter_mut().zip(outputs) {
                    *delta *= elu_slope(*output);
                }
            });
        }
        self.backward_first(rows, par, workspace, wanted);
    }

    /// Layer 1: its deltas summed per code and per moment, then the products.
    fn backward_first(
        &self,
        rows: &Rows<'_>,
        par: Par,
        workspace: &mut Workspace,
        wanted: Wanted<'_>,
    ) {
        let layer = &self.layers[0];
        let (width, code_count) = (layer.output_count, self.code_count());
        let delta = &workspace.deltas[0][..rows.code_of_row.len() * width];
        let code_sum = &mut workspace.code_part[..rows.codes.len() / code_count * width];
        add_rows_by_index(code_sum, delta, rows.code_of_row, width);
        if let Some(gradient) = wanted.decoder {
            let moment_count = rows.tau.len() / self.sinusoid_count();
            let time_sum = &mut workspace.time_part[..moment_count * width];
            add_rows_by_index(time_sum, delta, rows.moment_of_row, width);
            let gradient = &mut gradient[0];
            let codes = matrix(rows.codes, code_count);
            let tau = matrix(rows.tau, self.sinusoid_count());
            layer_gradient(gradient, 0, code_sum, codes, wanted.accumulate, par);
            layer_gradient(gradient, code_count, time_sum, tau, wanted.accumulate, par);
            sum_columns(&mut gradient.bias, code_sum, wanted.accumulate);
        }
        if let Some(code_gradient) = wanted.codes {
            multiply(
                matrix_mut(code_gradient, code_count),
                Accum::Replace,
                matrix(code_sum, width),
                layer.weight_columns(0..code_count),
                par,
            );
        }
    }
}

/// `deltaᵀ · input`, into the weight gradient's columns from `first_column` on.
fn layer_gradient(
    gradient: &mut DenseLayer,
    first_column: usize,
    delta: &[f32],
    input: MatRef<'_, f32>,
    accumulate: Accum,
    par: Par,
) {
    let columns = matrix_mut(&mut gradient.weights, gradient.input_count)
        .subcols_mut(first_column, input.ncols());
    let delta = matrix(delta, gradient.output_count).transpose();
    multiply(columns, accumulate, delta, input, par);
}

/// The sum of all rows, in row order.
fn sum_columns(sums: &mut [f32], rows: &[f32], accumulate: Accum) {
    if accumulate == Accum::Replace {
        sums.fill(0.0);
    }
    for row in rows.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// Replaces each sum by that of the rows which name it, in row order.
fn add_rows_by_index(sums: &mut [f32], rows: &[f32], index_of_row: &[usize], width: usize) {
    sums.fill(0.0);
    for (row, &index) in rows.chunks_exact(width).zip(index_of_row) {
        for (sum, value) in sums[index * width..][..width].iter_mut().zip(row) {
            *sum += value;
        }
    }
}
