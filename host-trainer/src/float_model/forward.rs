//! The forward pass: codes and times → standardised poses.
//!
//! In:  [`Rows`]: which code and which moment each row combines.
//! Out: the activations of every layer, kept in the [`Workspace`] for the backward pass.
//!
//! Why here: the inputs of layer 1 are pairs (code, moment), so its product is split: W·[code, τ] = W_c·code + W_τ·τ.
//! The first half is computed once per code, the second once per distinct moment, and a row costs one addition.

use core::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use super::activation::{ActivationGrid, elu};
use super::workspace::{Block, Pass, Workspace};
use super::{DenseLayer, FloatModel};
use crate::simd::vectorized;

/// Rows of a batch; each is the pose of one code at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// β then α. // (code, dimension)
    pub codes: &'a [f32],
    /// Time embeddings. // (moment, sinusoid)
    pub tau: &'a [f32],
    /// Index into `codes`. // (row)
    pub code_of_row: &'a [usize],
    /// Index into `tau`. // (row)
    pub moment_of_row: &'a [usize],
}

impl FloatModel {
    /// Decodes every row; the poses are then [`Workspace::outputs`].
    ///
    /// # Panics
    /// When the workspace is smaller than the batch.
    pub fn forward(&self, rows: &Rows<'_>, workspace: &mut Workspace) {
        let (first, code_count) = (&self.layers[0], self.code_count());
        let code_weights = first.weight_columns(0..code_count);
        let time_weights = first.weight_columns(code_count..first.input_count);
        multiply_rows(&mut workspace.code_part, rows.codes, code_weights.transpose());
        multiply_rows(&mut workspace.time_part, rows.tau, time_weights.transpose());
        workspace.cut(rows.code_of_row.len());
        let Pass { code_part, time_part, grids, blocks } = workspace.pass();
        blocks.par_iter_mut().for_each(|block| {
            self.forward_first(rows, [code_part, time_part], grids, block);
            self.forward_others(grids, block);
        });
    }

    /// Layer 1: adds what its halves gave for each row's code and moment.
    fn forward_first(
        &self,
        rows: &Rows<'_>,
        [code_part, time_part]: [&[f32]; 2],
        grids: &[ActivationGrid],
        block: &mut Block,
    ) {
        let width = self.layers[0].output_count;
        let numbers = block.rows.clone();
        let outputs = block.layers[0].activations_mut(numbers.len()).chunks_exact_mut(width);
        for (number, output) in numbers.zip(outputs) {
            let code = &code_part[rows.code_of_row[number] * width..][..width];
            let time = &time_part[rows.moment_of_row[number] * width..][..width];
            vectorized(|| {
                for ((output, code), time) in output.iter_mut().zip(code).zip(time) {
                    *output = code + time;
                }
            });
            self.finish_row(0, grids.first(), output);
        }
    }

    /// All layers after the first.
    fn forward_others(&self, grids: &[ActivationGrid], block: &mut Block) {
        let row_count = block.rows.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1) {
            let (before, after) = block.layers.split_at_mut(index);
            let output = after[0].activations_mut(row_count);
            let input = matrix(before[index - 1].activations(row_count), layer.input_count);
            let target = matrix_mut(output, layer.output_count);
            multiply(target, Accum::Replace, input, layer.weight_matrix().transpose());
            for row in output.chunks_exact_mut(layer.output_count) {
                self.finish_row(index, grids.get(index), row);
            }
        }
    }

    /// Adds the bias, applies the activation if the layer has one, and rounds it if there is a grid.
    fn finish_row(&self, layer: usize, grid: Option<&ActivationGrid>, row: &mut [f32]) {
        let bias = &self.layers[layer].bias;
        if layer + 1 < self.layers.len() {
            vectorized(|| {
                for (value, bias) in row.iter_mut().zip(bias) {
                    *value = elu(*value + bias);
                }
            });
            if let Some(grid) = grid {
                vectorized(|| row.iter_mut().for_each(|value| *value = grid.round(*value)));
            }
        } else {
            crate::simd::add(row, bias);
        }
    }
}

impl DenseLayer {
    /// All weights. // (out, in)
    pub(super) fn weight_matrix(&self) -> MatRef<'_, f32> {
        matrix(&self.weights, self.input_count)
    }

    /// The weights of some inputs only. // (out, in of the range)
    pub(super) fn weight_columns(&self, columns: Range<usize>) -> MatRef<'_, f32> {
        self.weight_matrix().subcols(columns.start, columns.len())
    }
}

/// `target = left · right`, rows shared among the threads; `target` may have room for more rows than `left` has.
pub(super) fn multiply_rows(target: &mut [f32], left: &[f32], right: MatRef<'_, f32>) {
    const ROWS_PER_TASK: usize = 64;
    target
        .par_chunks_mut(ROWS_PER_TASK * right.ncols())
        .zip(left.par_chunks(ROWS_PER_TASK * right.nrows()))
        .for_each(|(target, left)| {
            let left = matrix(left, right.nrows());
            let target = &mut target[..left.nrows() * right.ncols()];
            multiply(matrix_mut(target, right.ncols()), Accum::Replace, left, right);
        });
}

/// A row-major slice as a matrix. // (row, width)
pub(crate) fn matrix(values: &[f32], width: usize) -> MatRef<'_, f32> {
    MatRef::from_row_major_slice(values, values.len() / width, width)
}

/// A row-major slice as a matrix to write. // (row, width)
pub(crate) fn matrix_mut(values: &mut [f32], width: usize) -> MatMut<'_, f32> {
    let row_count = values.len() / width;
    MatMut::from_row_major_slice_mut(values, row_count, width)
}

/// `target = left · right`, or `+=`, on this thread.
pub(crate) fn multiply(
    target: MatMut<'_, f32>,
    accumulate: Accum,
    left: MatRef<'_, f32>,
    right: MatRef<'_, f32>,
) {
    matmul(target, accumulate, left, right, 1.0, Par::Seq);
}
