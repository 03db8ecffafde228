//! One fully connected layer as it lies in flash, and the proof that its accumulators cannot overflow.

use crate::elu::Elu;
use crate::error::BlobError;
use crate::kernel::{GROUP_SCALE_BYTES, GROUP_TILES, TILE_BYTES};
use crate::little_endian::{i32s, u16s, u32s};
use crate::manifest::{
    CODE_LAYER, LayerShape, NumberFormat, Packing, TIME_LAYER, TensorKind, WeightFormat,
};
use crate::packing::{BLOCK_ROWS, ByteLayout, nibble_weight};
use crate::requantize::Requantizer;

/// Four accumulators, one a row of a block.
pub(crate) type Sums = [i32; BLOCK_ROWS];

/// Tensors of one layer; which of them are empty depends on format and position, see `tensor_plan`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer<'a> {
    pub shape: LayerShape,
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
    /// Largest magnitude that the products of any row can reach together.
    products_max: i32,
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

impl Order {
    /// Of a layer by its place; the code half takes 16-bit codes in every integer format.
    fn new(weights: WeightFormat, packing: Packing, format: NumberFormat, index: usize) -> Self {
        let activations_are_bytes = index != CODE_LAYER && format.activation_range().1 == 127;
        match weights {
            WeightFormat::Half => Self::Half,
            WeightFormat::I4 => Self::Nibbles,
            WeightFormat::I8 => match ByteLayout::new(packing, activations_are_bytes) {
                ByteLayout::Bytes => Self::Bytes,
                ByteLayout::Halfwords => Self::Halfwords,
                ByteLayout::Rows if activations_are_bytes => Self::ByteRows,
                ByteLayout::Rows => Self::WideRows,
            },
        }
    }

    /// Accumulators per product of a weight and an activation.
    const fn product_unit(self) -> u64 {
        match self {
            Self::Halfwords | Self::ByteRows => 256,
            _ => 1,
        }
    }
}

impl<'a> Layer<'a> {
    pub fn new(shape: LayerShape, packing: Packing, format: NumberFormat, index: usize) -> Self {
        Self {
            shape,
            weights: &[],
            group_scales: &[],
            bias: &[],
            scales: &[],
            order: Order::new(shape.weights, packing, format, index),
            elu: Elu::NONE,
            products_max: 0,
        }
    }

    pub fn set_tensor(&mut self, kind: TensorKind, tensor: &'a [u8]) {
        match kind {
            TensorKind::Weights(_) => self.weights = tensor,
            TensorKind::GroupScales(_) => self.group_scales = tensor,
            TensorKind::Bias(_) => self.bias = tensor,
            TensorKind::Scales(_) => self.scales = tensor,
            _ => {}
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
        fours(self.scales).map(move |words| words.map(requantizer))
    }

    /// Largest magnitude at which a sum can start without ever overflowing.
    pub fn room(&self) -> i32 {
        i32::MAX - self.products_max
    }

    /// Checks scales and, for the integer formats, the certificate: the products of a row and its bias together stay
    /// below 2^31 whatever the activations are.
    pub fn check(&mut self, index: usize, format: NumberFormat) -> Result<(), BlobError> {
        let bad = |field| BlobError::BadField { field, value: index as u32 };
        if !format.allows(self.shape.weights) {
            return Err(bad("weight format of layer"));
        }
        if format == NumberFormat::F16 {
            return if self.is_finite() { Ok(()) } else { Err(bad("non-finite weight in layer")) };
        }
        self.elu =
            Elu::new(self.shape.activation, format).ok_or(bad("activation scale of layer"))?;
        if !u32s(self.scales).all(|bits| Requantizer::from_bits(bits).is_some()) {
            return Err(bad("row scale of layer"));
        }
        if u16s(self.group_scales).any(|scale| scale > i16::MAX as u16) {
            return Err(bad("group scale of layer"));
        }
        self.check_rows(index, format)
    }

    /// Whether every row's factor suits [`Requantizer::apply_narrow`], as hidden layers need.
    pub fn is_narrow(&self) -> bool {
        u32s(self.scales).all(|bits| bits & 63 >= Requantizer::NARROW_RIGHT_MIN)
    }

    fn check_rows(&mut self, index: usize, format: NumberFormat) -> Result<(), BlobError> {
        let input_max = input_magnitude_max(index, format, self.order);
        let biases = i32s(self.bias).map(i32::unsigned_abs).chain(core::iter::repeat(0));
        for (row, bias) in (0..self.shape.rows_filled()).zip(biases) {
            let products = self.products_max_of(row, input_max);
            if products + u64::from(bias) > i32::MAX as u64 {
                return Err(BlobError::AccumulatorOverflow { layer: index, row });
            }
            self.products_max = self.products_max.max(products as i32);
        }
        Ok(())
    }

    fn products_max_of(&self, row: usize, input_max: u64) -> u64 {
        if self.order == Order::Nibbles {
            return self.nibble_products_max(row, input_max);
        }
        let (block, _) = self.blocks().nth(row / BLOCK_ROWS).unwrap_or_default();
        let row = row % BLOCK_ROWS;
        let sum: u64 = match self.order {
            Order::WideRows | Order::ByteRows => {
                let columns = self.shape.columns_filled();
                u32s(block.get(row * columns..).unwrap_or_default())
                    .take(columns / 4)
                    .map(byte_magnitudes)
                    .sum()
            }
            Order::Halfwords => u32s(block).skip(row).step_by(4).map(halfword_magnitudes).sum(),
            _ => u32s(block).skip(row).step_by(4).map(byte_magnitudes).sum(),
        };
        sum * input_max * self.order.product_unit()
    }

    /// A 4-bit code half is multiplied by both bytes of the code, the lower of them counting 1/256.
    fn nibble_products_max(&self, row: usize, input_max: u64) -> u64 {
        let (block, scales) = self.blocks().nth(row / BLOCK_ROWS).unwrap_or_default();
        let groups = block.chunks(GROUP_TILES * TILE_BYTES);
        let bound = |(tiles, scales): (&[u8], &[u8])| {
            let words = u32s(tiles).skip(row % BLOCK_ROWS).step_by(BLOCK_ROWS);
            let magnitude = |word| (0..8).map(move |c| nibble_weight(word, c).unsigned_abs());
            let sum: u64 = words.flat_map(magnitude).map(u64::from).sum();
            let scale = u16s(scales).nth(row % BLOCK_ROWS).unwrap_or(0);
            ((sum * input_max * u64::from(scale)) >> 16) + 1
        };
        let products: u64 = groups.zip(scales.chunks(GROUP_SCALE_BYTES)).map(bound).sum();
        products + (products >> 8) + 1
    }

    fn is_finite(&self) -> bool {
        const EXPONENT: u16 = 0x7C00;
        let weights = u16s(self.weights).all(|weight| weight & EXPONENT != EXPONENT);
        weights && i32s(self.bias).all(|bits| f32::from_bits(bits.cast_unsigned()).is_finite())
    }
}

/// Σ|w| of four weights, a byte each.
fn byte_magnitudes(word: u32) -> u64 {
    word.to_le_bytes().map(|byte| u64::from(byte.cast_signed().unsigned_abs())).iter().sum()
}

/// Σ|w| of four weights, two in each halfword `256·w1 + w0`.
fn halfword_magnitudes(word: u32) -> u64 {
    let magnitude = |half: u16| {
        let first = half as i8;
        let second = i32::from(half.cast_signed()) - i32::from(first);
        u64::from(first.unsigned_abs()) + u64::from((second >> 8).unsigned_abs())
    };
    magnitude(word as u16) + magnitude((word >> 16) as u16)
}

/// The `i32`s of a tensor, four at a time.
pub(crate) fn fours(bytes: &[u8]) -> impl Iterator<Item = Sums> + '_ {
    let words = bytes.as_chunks().0;
    words.as_chunks().0.iter().map(|four| four.map(i32::from_le_bytes))
}

/// Largest magnitude of a stored input of a layer.
fn input_magnitude_max(index: usize, format: NumberFormat, order: Order) -> u64 {
    match (index, order) {
        // The bytes of a code: −128..=127 below, at most 128 above.
        (CODE_LAYER, Order::Nibbles) => 128,
        (CODE_LAYER, _) => 1 << 15,
        (TIME_LAYER, _) => format.sinusoid_one() as u64,
        _ => u64::from(format.activation_range().1.unsigned_abs()),
    }
}
