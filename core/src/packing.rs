//! How the weights of a layer lie in a blob: the one place that knows, for writer and reader.
//!
//! A *block* is four rows. Rows are filled up to a multiple of 4, columns to a multiple of 4 (16 with 4-bit weights),
//! with weights of 0.
//!
//! ```text
//! Tiles, i8     block, tile of 4 columns, row: a word with one weight a byte               (i16 activations)
//!               … a word of two halfwords 256·w1 + w0 and 256·w3 + w2                       (i8 activations)
//! Tiles, i4     block, tile of 8 columns, row: a word with one weight a nibble; from the
//!               top: columns 2, 3, 6, 7 in the upper half, 0, 1, 4, 5 in the lower
//! Rows, i8      row, column: a byte
//! Half          block, column, row: a binary16
//! ```
//!
//! Why here: the kernels read a layer with one pointer and never rearrange it; see `kernel.rs`.

use crate::kernel::{GROUP_SCALE_BYTES, GROUP_TILES, TILE_BYTES};
use crate::manifest::{LayerShape, NumberFormat, Packing, TIME_LAYER, WeightFormat};

/// Rows of a block.
pub const BLOCK_ROWS: usize = 4;

impl LayerShape {
    /// Rows with those that fill the last block.
    pub fn rows_filled(&self) -> usize {
        usize::from(self.output_count).next_multiple_of(BLOCK_ROWS)
    }

    /// Columns with those that fill the last tile; at least 4, so that no kernel meets an empty row.
    pub fn columns_filled(&self) -> usize {
        let multiple = if self.weights == WeightFormat::I4 { 16 } else { 4 };
        usize::from(self.input_count.max(1)).next_multiple_of(multiple)
    }

    /// Bytes of the weights of four rows.
    pub fn block_bytes(&self) -> usize {
        match self.weights {
            WeightFormat::I8 => 4 * self.columns_filled(),
            WeightFormat::I4 => 2 * self.columns_filled(),
            WeightFormat::Half => 8 * usize::from(self.input_count.max(1)),
        }
    }

    /// Bytes of the tensors of a layer in file order: weights, group scales, biases, scales.
    pub(crate) fn tensor_bytes(&self, index: usize, format: NumberFormat) -> [usize; 4] {
        let rows = self.rows_filled();
        let blocks = rows / BLOCK_ROWS;
        let bias = if index == TIME_LAYER { 0 } else { 4 * rows };
        let scales = if format == NumberFormat::F16 { 0 } else { 4 * rows };
        [blocks * self.block_bytes(), blocks * self.block_scale_bytes(), bias, scales]
    }

    /// Bytes of the group scales of four rows.
    pub fn block_scale_bytes(&self) -> usize {
        let groups = self.block_bytes().div_ceil(GROUP_TILES * TILE_BYTES);
        if self.weights == WeightFormat::I4 { groups * GROUP_SCALE_BYTES } else { 0 }
    }
}

/// How a layer's 8-bit weights share a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteLayout {
    /// Row after row.
    Rows,
    /// Tiles, one weight a byte.
    Bytes,
    /// Tiles, `256·w1 + w0` a halfword.
    Halfwords,
}

impl ByteLayout {
    /// Of the packing, for a layer whose activations have 8 or 16 bits.
    pub const fn new(packing: Packing, activations_are_bytes: bool) -> Self {
        match packing {
            Packing::Rows => Self::Rows,
            Packing::Tiles if activations_are_bytes => Self::Halfwords,
            Packing::Tiles => Self::Bytes,
        }
    }

    /// Index of the byte of a weight in a layer with `columns` filled columns.
    const fn offset(self, row: usize, column: usize, columns: usize) -> usize {
        match self {
            Self::Rows => row * columns + column,
            _ => {
                let block = row / BLOCK_ROWS * BLOCK_ROWS * columns;
                block + column / 4 * TILE_BYTES + row % BLOCK_ROWS * 4 + column % 4
            }
        }
    }

    /// Packs i8 weights into `output`, which must hold `rows_filled · columns_filled` zeros.
    ///
    /// # Shapes
    /// `weights` (row, column), `shape` without filling.
    pub fn pack(self, shape: &LayerShape, weights: &[i8], output: &mut [u8]) {
        let columns = shape.columns_filled();
        let rows = weights.chunks_exact(usize::from(shape.input_count.max(1)));
        for (row, weights) in rows.enumerate() {
            for (column, pair) in weights.chunks(2).enumerate() {
                let first = pair.first().copied().unwrap_or(0);
                let second = pair.get(1).copied().unwrap_or(0);
                // What the lower byte of `256·w1 + w0` takes from the upper one.
                let borrow = self == Self::Halfwords && first < 0;
                let offset = self.offset(row, 2 * column, columns);
                let bytes = [first, second.wrapping_sub(i8::from(borrow))];
                for (place, byte) in output.iter_mut().skip(offset).zip(bytes) {
                    *place = byte.cast_unsigned();
                }
            }
        }
    }
}

/// Place of a 4-bit weight in the word of its tile of eight columns: bits to the left.
pub const fn nibble_shift(column: usize) -> u32 {
    const SHIFTS: [u32; 8] = [12, 8, 28, 24, 4, 0, 20, 16];
    #[allow(clippy::indexing_slicing, reason = "the remainder is below 8")]
    SHIFTS[column % 8]
}

/// The 16-bit number that is the weight of `column` in a word of eight 4-bit weights: its own nibble and what lies
/// below.
pub const fn nibble_weight(word: u32, column: usize) -> i16 {
    ((word << (28 - nibble_shift(column))) >> 16) as i16
}
