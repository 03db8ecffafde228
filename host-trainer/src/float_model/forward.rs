//! The forward pass: codes and times → standardised poses.
//!
//! In:  [`Rows`]: which code and which moment each row combines.
//! Out: the activations of every layer, kept in the [`Workspace`] for the backward pass.
//!
//! Why here: the inputs of layer 1 are pairs (code, moment), so its product is split: W·[code, τ] = W_c·code + W_τ·τ.
//! The first half is computed once per code, the second once per distinct moment, and a row costs one addition.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rayon::prelude::*;

use super::activation::elu;
use super::{DenseLayer, FloatModel};

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

/// All buffers that the passes need; sized once for the largest batch.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// W_c·code; backward: the sum of layer 1's deltas over the rows of a code. // (code, unit of layer 1)
    pub(super) code_part: Vec<f32>,
    /// W_τ·τ; backward: the sum of layer 1's deltas over the rows of a moment. // (moment, unit of layer 1)
    pub(super) time_part: Vec<f32>,
    /// Output of every layer; the last is the pose. // (layer)(row, unit)
    pub(super) activations: Vec<Vec<f32>>,
    /// Gradient of the loss by every layer's sum before its activation. // (layer)(row, unit)
    pub(super) deltas: Vec<Vec<f32>>,
    channel_count: usize,
}

impl Workspace {
    /// Buffers for at most this many codes, moments and rows.
    pub fn new(model: &FloatModel, codes_max: usize, moments_max: usize, rows_max: usize) -> Self {
        let first_width = model.layers.first().map_or(0, |layer| layer.output_count);
        let per_layer = || {
            let buffer = |layer: &DenseLayer| vec![0.0; rows_max * layer.output_count];
            model.layers.iter().map(buffer).collect()
        };
        Self {
            code_part: vec![0.0; codes_max * first_width],
            time_part: vec![0.0; moments_max * first_width],
            activations: per_layer(),
            deltas: per_layer(),
            channel_count: model.channel_count(),
        }
    }

    /// The poses of the last forward pass. // (row, channel)
    pub fn output(&self, row_count: usize) -> &[f32] {
        let last = self.activations.len() - 1;
        &self.activations[last][..row_count * self.channel_count]
    }

    /// The poses, and the place for the loss's gradient by them that starts the backward pass. // (row, channel) each
    pub fn output_and_delta(&mut self, row_count: usize) -> (&[f32], &mut [f32]) {
        let (last, len) = (self.activations.len() - 1, row_count * self.channel_count);
        (&self.activations[last][..len], &mut self.deltas[last][..len])
    }
}

impl DenseLayer {
    /// All weights. // (out, in)
    pub(super) fn weight_matrix(&self) -> MatRef<'_, f32> {
        MatRef::from_row_major_slice(&self.weights, self.output_count, self.input_count)
    }

    /// The weights of some inputs only. // (out, in of the range)
    pub(super) fn weight_columns(&self, columns: Range<usize>) -> MatRef<'_, f32> {
        self.weight_matrix().subcols(columns.start, columns.len())
    }
}

impl FloatModel {
    /// Decodes every row; the poses are then [`Workspace::output`].
    ///
    /// # Panics
    /// When the workspace is smaller than the batch.
    pub fn forward(&self, rows: &Rows<'_>, par: Par, workspace: &mut Workspace) {
        self.forward_first(rows, par, workspace);
        let row_count = rows.code_of_row.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1) {
            let (before, after) = workspace.activations.split_at_mut(index);
            let input = &before[index - 1][..row_count * layer.input_count];
            let output = &mut after[0][..row_count * layer.output_count];
            multiply(
                matrix_mut(output, layer.output_count),
                Accum::Replace,
                matrix(input, layer.input_count),
                layer.weight_matrix().transpose(),
                par,
            );
            let activate = index + 1 < self.layers.len();
            for_each_row(output, layer.output_count, |_, row| {
                finish_row(row, &layer.bias, activate);
            });
        }
    }

    /// Layer 1, each half once per code and once per moment.
    fn forward_first(&self, rows: &Rows<'_>, par: Par, workspace: &mut Workspace) {
        let layer = &self.layers[0];
        let (width, code_count) = (layer.output_count, self.code_count());
        let moment_count = rows.tau.len() / self.sinusoid_count();
        let code_part = &mut workspace.code_part[..rows.codes.len() / code_count * width];
        let time_part = &mut workspace.time_part[..moment_count * width];
        multiply(
            matrix_mut(code_part, width),
            Accum::Replace,
            matrix(rows.codes, code_count),
            layer.weight_columns(0..code_count).transpose(),
            par,
        );
        multiply(
            matrix_mut(time_part, width),
            Accum::Replace,
            matrix(rows.tau, self.sinusoid_count()),
            layer.weight_columns(code_count..layer.input_count).transpose(),
            par,
        );
        let output = &mut workspace.activations[0][..rows.code_of_row.len() * width];
        let activate = self.layers.len() > 1;
        for_each_row(output, width, |index, row| {
            let code_row = &code_part[rows.code_of_row[index] * width..][..width];
            let time_row = &time_part[rows.moment_of_row[index] * width..][..width];
            for ((value, code), time) in row.iter_mut().zip(code_row).zip(time_row) {
                *value = code + time;
            }
            finish_row(row, &layer.bias, activate);
        });
    }
}

/// Adds the bias and applies the activation, if the layer has one.
fn finish_row(row: &mut [f32], bias: &[f32], activate: bool) {
    if activate {
        for (value, bias) in row.iter_mut().zip(bias) {
            *value = elu(*value + bias);
        }
    } else {
        for (value, bias) in row.iter_mut().zip(bias) {
            *value += bias;
        }
    }
}

/// Runs `action(row index, row)` on every row, shared among the threads.
pub(super) fn for_each_row(
    values: &mut [f32],
    width: usize,
    action: impl Fn(usize, &mut [f32]) + Sync,
) {
    /// Fewer values than this are not worth handing to another thread.
    const VALUES_PER_TASK: usize = 1 << 14;
    values
        .par_chunks_exact_mut(width)
        .with_min_len(VALUES_PER_TASK.div_ceil(width))
        .enumerate()
        .for_each(|(index, row)| action(index, row));
}

/// A row-major slice as a matrix. // (row, width)
pub(super) fn matrix(values: &[f32], width: usize) -> MatRef<'_, f32> {
    MatRef::from_row_major_slice(values, values.len() / width, width)
}

/// A row-major slice as a matrix to write. // (row, width)
pub(super) fn matrix_mut(values: &mut [f32], width: usize) -> MatMut<'_, f32> {
    let row_count = values.len() / width;
    MatMut::from_row_major_slice_mut(values, row_count, width)
}

/// `target = left · right`, or `+=`.
pub(super) fn multiply(
    target: MatMut<'_, f32>,
    accumulate: Accum,
    left: MatRef<'_, f32>,
    right: MatRef<'_, f32>,
    par: Par,
) {
    matmul(target, accumulate, left, right, 1.0, par);
}
