//! One fully connected layer as it lies in flash, and the proof that its accumulators cannot overflow.

use crate::blob::ALIGNMENT;
use crate::elu::Elu;
use crate::error::BlobError;
use crate::kernel::TILE_BYTES;
#[cfg(feature = "w4a8")]
use crate::kernel::{GROUP_SCALE_BYTES, GROUP_TILES};
use crate::little_endian::{i32s, u16s, u32s};
use crate::manifest::{CODE_LAYER, LayerShape, Manifest, NumberFormat, TIME_LAYER, WeightFormat};
use crate::packing::{BLOCK_ROWS, ByteLayout};
use crate::requantize::Requantizer;

/// Four accumulators, one a row of a block.
pub(crate) type Sums = [i32; BLOCK_ROWS];

/// Tensors of one layer; which of them are empty depends on format and position, see `tensor_plan`.
///
/// A view that is made anew for every use: a model with ten of them would be twice as large.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer<'a> {
    pub shape: &'a LayerShape,
    /// See `packing.rs`.
    pub weights: &'a [u8],
    /// u16. // (block, group, row)
    group_scales: &'a [u8],
    /// i32 or f32. // (out)
    pub bias: &'a [u8],
    /// Words of `Requantizer`. // (out)
    scales: &'a [u8],
    /// Order of the weights, and with it of the activations.
    pub order: Order,
    /// Pre-activation → stored activation.
    pub elu: Elu,
}

/// What the kernel of a layer expects of weights and activations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// i8 tiles, 16-bit activations in quads.
    Bytes,
    /// i8 tiles, 8-bit activations in quads with differences.
    Halfwords,
    /// 4-bit tiles, 8-bit activations in quads.
    Nibbles,
    /// i8 rows, 16-bit activations one after another.
    WideRows,
    /// i8 rows, 8-bit activations one after another, a byte each.
    ByteRows,
    /// binary16, f32 activations.
    Half,
}

/// Order and number of the quads that a layer reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inputs {
    pub order: Order,
    pub quads: usize,
}

impl Order {
    /// Of a layer by its place; the code half takes 16-bit codes in every integer format.
    pub fn of(manifest: &Manifest<'_>, index: usize) -> Option<Self> {
        let has_bytes = manifest.number_format.activation_range().1 == 127;
        let activations_are_bytes = has_bytes && index != CODE_LAYER;
        Some(match manifest.layers.get(index)?.weights {
            WeightFormat::Half => Self::Half,
            WeightFormat::I4 => Self::Nibbles,
            WeightFormat::I8 => match ByteLayout::new(manifest.packing, activations_are_bytes) {
                ByteLayout::Bytes => Self::Bytes,
                ByteLayout::Halfwords => Self::Halfwords,
                ByteLayout::Rows if activations_are_bytes => Self::ByteRows,
                ByteLayout::Rows => Self::WideRows,
            },
        })
    }

    /// Whether these are 4-bit weights, in a build that can multiply them.
    pub const fn is_nibbles(self) -> bool {
        cfg!(feature = "w4a8") && matches!(self, Self::Nibbles)
    }

    /// Accumulators per product of a weight and an activation.
    const fn product_unit(self) -> u32 {
        match self {
            Self::Halfwords | Self::ByteRows => 256,
            _ => 1,
        }
    }
}

impl<'a> Layer<'a> {
    /// Cuts a layer out of `tensors`, which begin with its weights.
    pub fn new(manifest: &'a Manifest<'_>, index: usize, tensors: &'a [u8]) -> Option<Self> {
        let shape = manifest.layers.get(index)?;
        let format = manifest.number_format;
        let mut rest = tensors;
        let [weights, group_scales, bias, scales] =
            shape.tensor_bytes(index, format).map(|length| {
                let tensor = rest.get(..length).unwrap_or_default();
                rest = rest.get(length.next_multiple_of(ALIGNMENT)..).unwrap_or_default();
                tensor
            });
        let order = Order::of(manifest, index)?;
        let elu = Elu::new(shape.activation, format);
        Some(Self { shape, weights, group_scales, bias, scales, order, elu })
    }

    /// The same layer with the scales of a motion's gates: the first of `words`, which are left with the others'.
    ///
    /// Nothing is gated where there are no words.
    pub fn gated<'b>(self, words: &mut &'b [u8]) -> Layer<'b>
    where
        'a: 'b,
    {
        match words.split_at_checked(4 * self.shape.rows_filled()) {
            Some((own, rest)) => {
                *words = rest;
                Layer { scales: own, ..self }
            }
            None => self,
        }
    }

    /// Weights and group scales, four rows at a time.
    pub fn blocks(&self) -> impl Iterator<Item = (&'a [u8], &'a [u8])> + use<'a> {
        let scale_bytes = self.shape.block_scale_bytes();
        let block_bytes = self.shape.block_bytes(); // At least 8, see `columns_filled`.
        let (mut weights, mut group_scales) = (self.weights, self.group_scales);
        core::iter::from_fn(move || {
            let (block, scales);
            (block, weights) = weights.split_at_checked(block_bytes)?;
            (scales, group_scales) = group_scales.split_at_checked(scale_bytes).unwrap_or_default();
            Some((block, scales))
        })
    }

    /// Biases, four rows at a time; integer formats.
    pub fn biases(&self) -> impl Iterator<Item = Sums> + use<'a> {
        fours(self.bias)
    }

    /// Accumulator → next format, four rows at a time; integer formats.
    pub fn requantizers(&self) -> impl Iterator<Item = [Requantizer; BLOCK_ROWS]> + use<'a> {
        let requantizer = |bits: i32| Requantizer::from_checked_bits(bits.cast_unsigned());
        let all = move |[a, b, c, d]: Sums| {
            [requantizer(a), requantizer(b), requantizer(c), requantizer(d)]
        };
        fours(self.scales).map(all)
    }

    /// Checks scales and, for the integer formats, the certificate: the products of a row and its bias together stay
    /// below 2^31 whatever the activations are.
    ///
    /// Returns the largest magnitude that the products of any row can reach together.
    pub fn check(&self, manifest: &Manifest<'_>, index: usize) -> Result<i32, BlobError> {
        let bad = |field| BlobError::BadField { field, value: index as u32 };
        let format = manifest.number_format;
        if !format.allows(self.shape.weights) {
            return Err(bad("weight format of layer"));
        }
        if cfg!(feature = "f16") && format == NumberFormat::F16 {
            return if self.is_finite() { Ok(0) } else { Err(bad("non-finite weight in layer")) };
        }
        if !Elu::is_valid(&self.shape.activation, format) {
            return Err(bad("activation scale of layer"));
        }
        let is_hidden = index >= TIME_LAYER && index + 1 < manifest.layers.len();
        if !self.scales_suit(is_hidden) {
            return Err(bad("row scale of layer"));
        }
        if u16s(self.group_scales).any(|scale| scale > i16::MAX as u16) {
            return Err(bad("group scale of layer"));
        }
        self.products_max(index, input_magnitude_max(index, format, self.order))
    }

    /// Hidden layers use [`Requantizer::apply_narrow`], which not every factor suits.
    fn scales_suit(&self, is_hidden: bool) -> bool {
        let right_min = if is_hidden { Requantizer::NARROW_RIGHT_MIN } else { 0 };
        u32s(self.scales).all(|bits| {
            Requantizer::from_bits(bits).is_some_and(|scale| scale.right() >= right_min)
        })
    }

    fn products_max(&self, index: usize, input_max: u32) -> Result<i32, BlobError> {
        let mut products_max = 0;
        let mut biases = self.biases();
        for (block_index, block) in self.blocks().enumerate() {
            let bias = biases.next().unwrap_or_default();
            let products = self.block_products_max(block, input_max);
            for (row, (products, bias)) in products.into_iter().zip(bias).enumerate() {
                if products + u64::from(bias.unsigned_abs()) > i32::MAX as u64 {
                    let row = BLOCK_ROWS * block_index + row;
                    return Err(BlobError::AccumulatorOverflow { layer: index, row });
                }
                products_max = products_max.max(products as i32);
            }
        }
        Ok(products_max)
    }

    fn block_products_max(&self, block: (&[u8], &[u8]), input_max: u32) -> [u64; BLOCK_ROWS] {
        #[cfg(feature = "w4a8")]
        if self.order == Order::Nibbles {
            return nibble_products_max(block, input_max);
        }
        #[cfg(karakuri_rows)]
        if matches!(self.order, Order::WideRows | Order::ByteRows) {
            let mut rows = block.0.chunks(self.shape.columns_filled());
            let sum = |row: &[u8]| u32s(row).map(byte_magnitudes).sum::<u32>();
            let sums = [(); BLOCK_ROWS].map(|()| rows.next().map_or(0, sum));
            return sums
                .map(|sum| u64::from(sum) * u64::from(input_max * self.order.product_unit()));
        }
        let mut sums = [0; BLOCK_ROWS];
        for tile in block.0.as_chunks::<TILE_BYTES>().0 {
            for (word, sum) in u32s(tile).zip(&mut sums) {
                let is_halves = self.order == Order::Halfwords;
                *sum += byte_magnitudes(if is_halves { bytes_of_halfwords(word) } else { word });
            }
        }
        sums.map(|sum| u64::from(sum) * u64::from(input_max * self.order.product_unit()))
    }

    fn is_finite(&self) -> bool {
        const EXPONENT: u16 = 0x7C00;
        let weights = u16s(self.weights).all(|weight| weight & EXPONENT != EXPONENT);
        weights && i32s(self.bias).all(|bits| f32::from_bits(bits.cast_unsigned()).is_finite())
    }
}

/// A 4-bit code half is multiplied by both bytes of the code, the lower of them counting 1/256.
#[cfg(feature = "w4a8")]
fn nibble_products_max(block: (&[u8], &[u8]), input_max: u32) -> [u64; BLOCK_ROWS] {
    let groups = block.0.chunks(GROUP_TILES * TILE_BYTES).zip(block.1.chunks(GROUP_SCALE_BYTES));
    let mut products = [0; BLOCK_ROWS];
    for (tiles, scales) in groups {
        let mut sums = [0; BLOCK_ROWS];
        for tile in tiles.as_chunks::<TILE_BYTES>().0 {
            u32s(tile).zip(&mut sums).for_each(|(word, sum)| *sum += nibble_magnitudes(word));
        }
        for ((products, sum), scale) in products.iter_mut().zip(sums).zip(u16s(scales)) {
            *products += ((u64::from(sum * input_max) * u64::from(scale)) >> 16) + 1;
        }
    }
    products.map(|products| products + (products >> 8) + 1)
}

/// Σ|w| of eight 4-bit weights, each with what lies below it, see `nibble_weight`.
#[cfg(feature = "w4a8")]
fn nibble_magnitudes(word: u32) -> u32 {
    let weight = |column: u32| ((word << (4 * column)) >> 16) as i16;
    (0..8).map(|column| u32::from(weight(column).unsigned_abs())).sum()
}

/// Σ|w| of four weights, a byte each.
fn byte_magnitudes(word: u32) -> u32 {
    let magnitude = |shift: u32| u32::from(((word >> shift) as i8).unsigned_abs());
    magnitude(0) + magnitude(8) + magnitude(16) + magnitude(24)
}

/// Two halfwords `256·w1 + w0` as bytes: the upper one gets back what the lower one took from it.
fn bytes_of_halfwords(word: u32) -> u32 {
    let taken = (word & 0x0080_0080) << 1;
    ((word & 0x7FFF_7FFF) + taken) ^ (word & 0x8000_8000)
}

/// The `i32`s of a tensor, four at a time.
pub(crate) fn fours(bytes: &[u8]) -> impl Iterator<Item = Sums> + '_ {
    let words = bytes.as_chunks().0;
    // Not `map` on the array, which is a loop with a copy where code is compiled for size.
    words.as_chunks().0.iter().map(|&[a, b, c, d]: &[[u8; 4]; 4]| {
        let number = i32::from_le_bytes;
        [number(a), number(b), number(c), number(d)]
    })
}

/// Largest magnitude of a stored input of a layer.
fn input_magnitude_max(index: usize, format: NumberFormat, order: Order) -> u32 {
    match (index, order) {
        // The bytes of a code: −128..=127 below, at most 128 above.
        (CODE_LAYER, Order::Nibbles) => 128,
        (CODE_LAYER, _) => 1 << 15,
        (TIME_LAYER, _) => format.sinusoid_one() as u32,
        _ => u32::from(format.activation_range().1.unsigned_abs()),
    }
}
