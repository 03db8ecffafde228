//! The buffers that the forward and backward pass share.
//!
//! Why here: the rows of a batch are cut into blocks, and a block goes through all layers on one thread. So a pass
//! meets its threads once instead of once a layer, and the result does not depend on their number, because the blocks
//! do not.

use core::ops::Range;

use rayon::prelude::*;

use super::activation::ActivationGrid;
use super::forward::Rows;
use super::{DenseLayer, FloatModel};
use crate::simd;

/// Most rows of a block: few enough that a batch feeds several threads, many enough that reading a layer's weights
/// pays.
const BLOCK_ROWS_MAX: usize = 128;

/// All buffers that the passes need; sized once for the largest batch.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// W_c·code; backward: the sum of layer 1's deltas over the rows of a code. // (code, unit of layer 1)
    pub(super) code_part: Vec<f32>,
    /// W_τ·τ; backward: the sum of layer 1's deltas over the rows of a moment. // (moment, unit of layer 1)
    pub(super) time_part: Vec<f32>,
    /// Rows of gates and phases by code; backward: the gradient by them. Empty without modulation. // (code, row)
    pub(super) modulation_part: Vec<f32>,
    rows_of_code: Groups,
    rows_of_moment: Groups,
    blocks: Vec<Block>,
    block_count: usize,
    /// Where hidden activations are rounded to; empty: nowhere. // (hidden layer)
    grids: Vec<ActivationGrid>,
}

/// What [`Workspace::pass`] lends.
pub(super) struct Pass<'a> {
    /// What the forward pass computed once for many rows.
    pub parts: Parts<'a>,
    /// See `Workspace`. // (hidden layer) or empty
    pub grids: &'a [ActivationGrid],
    /// Of the present batch.
    pub blocks: &'a mut [Block],
}

/// See [`Workspace`].
#[derive(Clone, Copy)]
pub(super) struct Parts<'a> {
    /// Layer 1 by code. // (code, unit of layer 1)
    pub code: &'a [f32],
    /// Layer 1 by moment. // (moment, unit of layer 1)
    pub time: &'a [f32],
    /// Gates and phases by code. // (code, row)
    modulation: &'a [f32],
}

impl<'a> Parts<'a> {
    /// Gates and phases of a code; nothing without modulation.
    pub fn modulation_of(self, code: usize, model: &FloatModel) -> &'a [f32] {
        let rows = model.modulation.as_ref().map_or(0, |layer| layer.output_count);
        &self.modulation[code * rows..][..rows]
    }
}

/// Consecutive rows of a batch.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Which rows of the batch.
    pub rows: Range<usize>,
    /// Per layer.
    pub layers: Vec<BlockLayer>,
    /// Each row's own sinusoids; empty without phases. // (row of the block, sinusoid)
    pub tau: Vec<f32>,
    /// The gradient by them. // (row of the block, sinusoid)
    pub tau_deltas: Vec<f32>,
    /// The gradient by the phases. // (row of the block, frequency)
    pub phase_deltas: Vec<f32>,
}

/// What a block keeps of one layer.
#[derive(Clone, Debug)]
pub(super) struct BlockLayer {
    width: usize,
    /// Output of the layer; of the last one: the poses. // (row of the block, unit)
    activations: Vec<f32>,
    /// Gradient of the loss by the layer's sums before their activation. // (row of the block, unit)
    deltas: Vec<f32>,
    /// Sums before their gates; backward: the gradient by the gates' rows. Empty without. // (row of the block, unit)
    sums: Vec<f32>,
}

/// The rows of every code, or of every moment.
#[derive(Clone, Debug, Default)]
struct Groups {
    /// Where each group's rows start in `rows`; one number more than groups. // (group + 1)
    starts: Vec<usize>,
    /// Row numbers, group after group, ascending in each.
    rows: Vec<usize>,
}

impl Workspace {
    /// Buffers for at most this many codes, moments and rows.
    pub fn new(model: &FloatModel, codes_max: usize, moments_max: usize, rows_max: usize) -> Self {
        let first_width = model.layers.first().map_or(0, |layer| layer.output_count);
        let rows_of_block = rows_max.min(BLOCK_ROWS_MAX);
        let layer = |(index, dense): (usize, &DenseLayer)| BlockLayer {
            width: dense.output_count,
            activations: vec![0.0; rows_of_block * dense.output_count],
            deltas: vec![0.0; rows_of_block * dense.output_count],
            sums: vec![0.0; rows_of_block * model.gate_rows(index).len()],
        };
        let phase_count = model.phase_rows().len();
        let block = Block {
            rows: 0..0,
            layers: model.layers.iter().enumerate().map(layer).collect(),
            tau: vec![0.0; rows_of_block * 2 * phase_count],
            tau_deltas: vec![0.0; rows_of_block * 2 * phase_count],
            phase_deltas: vec![0.0; rows_of_block * phase_count],
        };
        let modulation_rows = model.modulation.as_ref().map_or(0, |layer| layer.output_count);
        Self {
            modulation_part: vec![0.0; codes_max * modulation_rows],
            code_part: vec![0.0; codes_max * first_width],
            time_part: vec![0.0; moments_max * first_width],
            rows_of_code: Groups::with_capacity(codes_max, rows_max),
            rows_of_moment: Groups::with_capacity(moments_max, rows_max),
            blocks: vec![block; rows_max.div_ceil(BLOCK_ROWS_MAX)],
            block_count: 0,
            grids: Vec::new(),
        }
    }

    /// From now on both passes see activations as a device stores them. // (hidden layer)
    pub fn round_activations(&mut self, grids: Vec<ActivationGrid>) {
        self.grids = grids;
    }

    /// Cuts a batch of this many rows into blocks of nearly equal size.
    pub(super) fn cut(&mut self, row_count: usize) {
        let block_count = row_count.div_ceil(BLOCK_ROWS_MAX);
        for (index, block) in self.blocks[..block_count].iter_mut().enumerate() {
            block.rows = index * row_count / block_count..(index + 1) * row_count / block_count;
        }
        self.block_count = block_count;
    }

    /// The blocks of the present batch.
    pub(super) fn blocks(&self) -> &[Block] {
        &self.blocks[..self.block_count]
    }

    /// All that a pass through the blocks needs.
    pub(super) fn pass(&mut self) -> Pass<'_> {
        Pass {
            parts: Parts {
                code: &self.code_part,
                time: &self.time_part,
                modulation: &self.modulation_part,
            },
            grids: &self.grids,
            blocks: &mut self.blocks[..self.block_count],
        }
    }

    /// Layer 1's deltas, summed per code and per moment, in the place of the forward pass's parts; gradients by gates
    /// and phases per code.
    pub(super) fn sum_first_deltas(&mut self, rows: &Rows<'_>, model: &FloatModel) {
        let blocks = &self.blocks[..self.block_count];
        let first = |block| BlockLayer::all_deltas(block, 0);
        let width = model.layers[0].output_count;
        let columns = (width, 0..width);
        self.rows_of_code.sort(rows.code_of_row);
        sum_by_group(&mut self.code_part, columns.clone(), blocks, &self.rows_of_code, first);
        if !model.has_phases() {
            self.rows_of_moment.sort(rows.moment_of_row);
            sum_by_group(&mut self.time_part, columns, blocks, &self.rows_of_moment, first);
        }
        let Some(modulation) = &model.modulation else {
            return;
        };
        let (part, groups) = (&mut self.modulation_part, &self.rows_of_code);
        let width = modulation.output_count;
        for layer in 0..model.layers.len() - 1 {
            let sums = |block| BlockLayer::all_sums(block, layer);
            sum_by_group(part, (width, model.gate_rows(layer)), blocks, groups, sums);
        }
        if model.has_phases() {
            sum_by_group(part, (width, model.phase_rows()), blocks, groups, Block::phase_deltas);
        }
    }

    /// The poses of the last forward pass, row by row. // each (channel)
    pub fn outputs(&self) -> impl Iterator<Item = &[f32]> {
        self.blocks().iter().flat_map(|block| {
            let last = &block.layers[block.layers.len() - 1];
            last.activations.chunks_exact(last.width).take(block.rows.len())
        })
    }

    /// Row by row the pose, and the place for the loss's gradient by it that starts the backward pass. // (channel)
    /// each
    pub fn outputs_and_deltas(&mut self) -> impl Iterator<Item = (&[f32], &mut [f32])> {
        self.blocks[..self.block_count].iter_mut().flat_map(|block| {
            let last = block.layers.len() - 1;
            let BlockLayer { width, activations, deltas, .. } = &mut block.layers[last];
            let rows = activations.chunks_exact(*width).zip(deltas.chunks_exact_mut(*width));
            rows.take(block.rows.len())
        })
    }
}

impl Block {
    /// The gradient by the phases. // (row of the block, frequency)
    fn phase_deltas(&self) -> &[f32] {
        &self.phase_deltas
    }
}

impl BlockLayer {
    /// Deltas of a layer, those beyond the present rows too. // (row of the block, unit)
    fn all_deltas(block: &Block, layer: usize) -> &[f32] {
        &block.layers[layer].deltas
    }

    /// Gradient by the rows of a layer's gates, the same way. // (row of the block, unit)
    fn all_sums(block: &Block, layer: usize) -> &[f32] {
        &block.layers[layer].sums
    }

    /// The outputs of the first rows. // (row, unit)
    pub fn activations(&self, row_count: usize) -> &[f32] {
        &self.activations[..row_count * self.width]
    }

    /// The outputs of the first rows, to be written. // (row, unit)
    pub fn activations_mut(&mut self, row_count: usize) -> &mut [f32] {
        &mut self.activations[..row_count * self.width]
    }

    /// One row's outputs, to be written. // (unit)
    pub fn row_mut(&mut self, place: usize) -> &mut [f32] {
        &mut self.activations[place * self.width..][..self.width]
    }

    /// One row's outputs and its sums before their gates, to be written. // (unit) each
    pub fn row_and_sums_mut(&mut self, place: usize) -> (&mut [f32], &mut [f32]) {
        let range = place * self.width..(place + 1) * self.width;
        (&mut self.activations[range.clone()], &mut self.sums[range])
    }

    /// One row's deltas and its sums before their gates, to be written. // (unit) each
    pub fn deltas_and_sums_mut(&mut self, place: usize) -> (&mut [f32], &mut [f32]) {
        let range = place * self.width..(place + 1) * self.width;
        (&mut self.deltas[range.clone()], &mut self.sums[range])
    }

    /// The deltas of the first rows. // (row, unit)
    pub fn deltas(&self, row_count: usize) -> &[f32] {
        &self.deltas[..row_count * self.width]
    }

    /// The outputs, and the deltas to be written. // (row, unit) each
    pub fn activations_and_deltas_mut(&mut self, row_count: usize) -> (&[f32], &mut [f32]) {
        let len = row_count * self.width;
        (&self.activations[..len], &mut self.deltas[..len])
    }
}

impl Groups {
    fn with_capacity(groups_max: usize, rows_max: usize) -> Self {
        Self { starts: Vec::with_capacity(groups_max + 1), rows: Vec::with_capacity(rows_max) }
    }

    /// Sorts rows by their group, keeping their order inside each.
    fn sort(&mut self, group_of_row: &[usize]) {
        let group_count = group_of_row.iter().max().map_or(0, |last| last + 1);
        self.starts.clear();
        self.starts.resize(group_count + 1, 0);
        for &group in group_of_row {
            self.starts[group + 1] += 1;
        }
        for group in 0..group_count {
            self.starts[group + 1] += self.starts[group];
        }
        self.rows.clear();
        self.rows.resize(group_of_row.len(), 0);
        // Each start moves to its end while rows are placed, …
        for (row, &group) in group_of_row.iter().enumerate() {
            self.rows[self.starts[group]] = row;
            self.starts[group] += 1;
        }
        // … which is where the next group starts.
        self.starts.copy_within(0..group_count, 1);
        self.starts[0] = 0;
    }

    /// Number of groups.
    fn count(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// The rows of one group, ascending.
    fn rows(&self, group: usize) -> &[usize] {
        &self.rows[self.starts[group]..self.starts[group + 1]]
    }
}

/// For every group, the sum over its rows of what `values` names, into some columns of `sums`.
///
/// # Shapes
/// `sums` (group, `width`) · `values` (row of the block, column)
fn sum_by_group<'b>(
    sums: &mut [f32],
    (width, columns): (usize, Range<usize>),
    blocks: &'b [Block],
    groups: &Groups,
    values: impl Fn(&'b Block) -> &'b [f32] + Sync,
) {
    let sums = sums.par_chunks_exact_mut(width).take(groups.count());
    sums.enumerate().for_each(|(group, sum)| {
        let sum = &mut sum[columns.clone()];
        sum.fill(0.0);
        for &row in groups.rows(group) {
            let block = &blocks[blocks.partition_point(|block| block.rows.end <= row)];
            let start = (row - block.rows.start) * columns.len();
            simd::add(sum, &values(block)[start..][..columns.len()]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_hold_their_rows_in_order() {
        let mut groups = Groups::default();
        groups.sort(&[2, 0, 2, 3, 0, 0]);
        let rows: Vec<&[usize]> = (0..4).map(|group| groups.rows(group)).collect();
        assert_eq!(rows, [&[1, 4, 5][..], &[], &[0, 2], &[3]]);
    }
}
