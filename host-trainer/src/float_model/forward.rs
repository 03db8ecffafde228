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
use super::modulation::{gate, turn};
use super::workspace::{Block, BlockLayer, Parts, Pass, Workspace};
use super::{DenseLayer, FloatModel};
use crate::simd::{self, vectorized};

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
        let codes = (Accum::Replace, rows.codes);
        multiply_rows(&mut workspace.code_part, codes, code_weights.transpose());
        if !self.has_phases() {
            let tau = (Accum::Replace, rows.tau);
            multiply_rows(&mut workspace.time_part, tau, time_weights.transpose());
        }
        if let Some(layer) = &self.modulation {
            let part = &mut workspace.modulation_part;
            multiply_rows(part, codes, layer.weight_matrix().transpose());
            part.chunks_exact_mut(layer.output_count).for_each(|row| simd::add(row, &layer.bias));
        }
        workspace.cut(rows.code_of_row.len());
        let Pass { parts, grids, blocks } = workspace.pass();
        blocks.par_iter_mut().for_each(|block| {
            if self.has_phases() {
                self.forward_turned(rows, parts, grids, block);
            } else {
                self.forward_first(rows, parts, grids, block);
            }
            self.forward_others(rows, parts, grids, block);
        });
    }

    /// Layer 1 where every row has sinusoids of its own.
    fn forward_turned(
        &self,
        rows: &Rows<'_>,
        parts: Parts<'_>,
        grids: &[ActivationGrid],
        block: &mut Block,
    ) {
        let (width, sinusoid_count) = (self.layers[0].output_count, self.sinusoid_count());
        let phases = self.phase_rows();
        let turned = &mut block.tau[..block.rows.len() * sinusoid_count];
        for (number, turned) in block.rows.clone().zip(turned.chunks_exact_mut(sinusoid_count)) {
            let tau = &rows.tau[rows.moment_of_row[number] * sinusoid_count..][..sinusoid_count];
            let row = parts.modulation_of(rows.code_of_row[number], self);
            turn(tau, &row[phases.clone()], turned);
        }
        let time_weights =
            self.layers[0].weight_columns(self.code_count()..self.layers[0].input_count);
        let output = block.layers[0].activations_mut(block.rows.len());
        let target = matrix_mut(output, width);
        multiply(target, Accum::Replace, matrix(turned, sinusoid_count), time_weights.transpose());
        for (place, &code) in rows.code_of_row[block.rows.clone()].iter().enumerate() {
            let first = &mut block.layers[0];
            simd::add(first.row_mut(place), &parts.code[code * width..][..width]);
            self.finish_row(0, grids.first(), parts.modulation_of(code, self), first, place);
        }
    }

    /// Layer 1: adds what its halves gave for each row's code and moment.
    fn forward_first(
        &self,
        rows: &Rows<'_>,
        parts: Parts<'_>,
        grids: &[ActivationGrid],
        block: &mut Block,
    ) {
        let width = self.layers[0].output_count;
        for (place, number) in block.rows.clone().enumerate() {
            let code_index = rows.code_of_row[number];
            let code = &parts.code[code_index * width..][..width];
            let time = &parts.time[rows.moment_of_row[number] * width..][..width];
            let output = block.layers[0].row_mut(place);
            vectorized(|| {
                for ((output, code), time) in output.iter_mut().zip(code).zip(time) {
                    *output = code + time;
                }
            });
            let modulation = parts.modulation_of(code_index, self);
            self.finish_row(0, grids.first(), modulation, &mut block.layers[0], place);
        }
    }

    /// All layers after the first.
    fn forward_others(
        &self,
        rows: &Rows<'_>,
        parts: Parts<'_>,
        grids: &[ActivationGrid],
        block: &mut Block,
    ) {
        let row_count = block.rows.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1) {
            let (before, after) = block.layers.split_at_mut(index);
            let output = after[0].activations_mut(row_count);
            let input = matrix(before[index - 1].activations(row_count), layer.input_count);
            let target = matrix_mut(output, layer.output_count);
            multiply(target, Accum::Replace, input, layer.weight_matrix().transpose());
            for (place, &code) in rows.code_of_row[block.rows.clone()].iter().enumerate() {
                let modulation = parts.modulation_of(code, self);
                self.finish_row(index, grids.get(index), modulation, &mut after[0], place);
            }
        }
    }

    /// Adds the bias, applies gates and activation if the layer has them, and rounds it if there is a grid.
    fn finish_row(
        &self,
        layer: usize,
        grid: Option<&ActivationGrid>,
        modulation: &[f32],
        target: &mut BlockLayer,
        place: usize,
    ) {
        let bias = &self.layers[layer].bias;
        if layer + 1 == self.layers.len() {
            return crate::simd::add(target.row_mut(place), bias);
        }
        let gates = modulation.get(self.gate_rows(layer)).unwrap_or_default();
        if gates.is_empty() {
            let row = target.row_mut(place);
            vectorized(|| {
                for (value, bias) in row.iter_mut().zip(bias) {
                    *value = elu(*value + bias);
                }
            });
        } else {
            let (row, sums) = target.row_and_sums_mut(place);
            vectorized(|| {
                let values = row.iter_mut().zip(sums).zip(bias);
                for (((value, sum), bias), row) in values.zip(gates) {
                    *sum = *value + bias;
                    *value = elu(*sum * gate(*row));
                }
            });
        }
        if let Some(grid) = grid {
            let row = target.row_mut(place);
            vectorized(|| row.iter_mut().for_each(|value| *value = grid.round(*value)));
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

/// `target = left · right`, or `+=`, rows shared among the threads; `target` may have room for more rows than `left`
/// has.
pub(super) fn multiply_rows(
    target: &mut [f32],
    (accumulate, left): (Accum, &[f32]),
    right: MatRef<'_, f32>,
) {
    const ROWS_PER_TASK: usize = 64;
    target
        .par_chunks_mut(ROWS_PER_TASK * right.ncols())
        .zip(left.par_chunks(ROWS_PER_TASK * right.nrows()))
        .for_each(|(target, left)| {
            let left = matrix(left, right.nrows());
            let target = &mut target[..left.nrows() * right.ncols()];
            multiply(matrix_mut(target, right.ncols()), accumulate, left, right);
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
