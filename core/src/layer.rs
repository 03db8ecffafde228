//! One fully connected layer as it lies in flash, and the proof that its accumulators cannot overflow.

use crate::error::BlobError;
use crate::little_endian::{i8s, i32s, u16s};
use crate::manifest::{CODE_LAYER, LayerShape, NumberFormat, TIME_LAYER, TensorKind};
use crate::requantize::Requantizer;

/// Tensors of one layer; which of them are empty depends on format and position, see `tensor_plan`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layer<'a> {
    pub shape: LayerShape,
    /// i8 or binary16. // (out, in)
    pub weights: &'a [u8],
    /// i32 or f32. // (out)
    pub bias: &'a [u8],
    /// i32. // (out)
    multipliers: &'a [u8],
    /// i8. // (out)
    shifts: &'a [u8],
    /// ELU → stored activation.
    pub activation: Requantizer,
}

impl<'a> Layer<'a> {
    pub fn new(shape: LayerShape) -> Self {
        let activation = Requantizer::ZERO;
        Self { shape, weights: &[], bias: &[], multipliers: &[], shifts: &[], activation }
    }

    pub fn set_tensor(&mut self, kind: TensorKind, tensor: &'a [u8]) {
        match kind {
            TensorKind::Weights(_) => self.weights = tensor,
            TensorKind::Bias(_) => self.bias = tensor,
            TensorKind::Multipliers(_) => self.multipliers = tensor,
            TensorKind::Shifts(_) => self.shifts = tensor,
            _ => {}
        }
    }

    /// Inputs, at least 1 once the shapes are checked; `chunks_exact` must not see a 0.
    pub fn input_count(&self) -> usize {
        usize::from(self.shape.input_count).max(1)
    }

    /// Bytes of the weights of every row; integer formats.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &'a [u8]> + use<'a> {
        self.weights.chunks_exact(self.input_count())
    }

    /// Accumulator → next format, a row each; integer formats.
    pub fn requantizers(&self) -> impl Iterator<Item = Requantizer> + use<'a> {
        i32s(self.multipliers).zip(i8s(self.shifts)).map(|(multiplier, shift)| {
            Requantizer::new(multiplier, shift).unwrap_or(Requantizer::ZERO)
        })
    }

    /// Checks scales and, for the integer formats, the certificate: Σ|w| · max|a| + |bias| < 2^31 in every row.
    pub fn check(&mut self, index: usize, format: NumberFormat) -> Result<(), BlobError> {
        let bad = |field| BlobError::BadField { field, value: index as u32 };
        if format == NumberFormat::F16 {
            return if self.is_finite() { Ok(()) } else { Err(bad("non-finite weight in layer")) };
        }
        let scale = self.shape.activation;
        self.activation = Requantizer::new(scale.multiplier, scale.shift)
            .ok_or(bad("activation scale of layer"))?;
        let (low, high) = format.activation_range();
        if !(low..=high).contains(&scale.zero_point) {
            return Err(bad("zero point of layer"));
        }
        let valid = |(multiplier, shift)| Requantizer::new(multiplier, shift).is_some();
        if !i32s(self.multipliers).zip(i8s(self.shifts)).all(valid) {
            return Err(bad("row scale of layer"));
        }
        match self.first_overflowing_row(index, format) {
            Some(row) => Err(BlobError::AccumulatorOverflow { layer: index, row }),
            None => Ok(()),
        }
    }

    fn first_overflowing_row(&self, index: usize, format: NumberFormat) -> Option<usize> {
        let input_max = input_magnitude_max(index, format);
        let biases = i32s(self.bias).map(i32::unsigned_abs).chain(core::iter::repeat(0));
        let worst = |(row, bias)| u64::from(bias) + weight_magnitude_sum(row) * input_max;
        self.rows().zip(biases).map(worst).position(|sum| sum > i32::MAX as u64)
    }

    fn is_finite(&self) -> bool {
        const EXPONENT: u16 = 0x7C00;
        let weights = u16s(self.weights).all(|weight| weight & EXPONENT != EXPONENT);
        weights && i32s(self.bias).all(|bits| f32::from_bits(bits.cast_unsigned()).is_finite())
    }
}

/// Largest magnitude of a stored input of a layer.
pub(crate) fn input_magnitude_max(index: usize, format: NumberFormat) -> u64 {
    match index {
        CODE_LAYER => 1 << 15,
        TIME_LAYER => format.sinusoid_one() as u64,
        _ => u64::from(format.activation_range().0.unsigned_abs()),
    }
}

/// Σ|w| of a row; at most 4096 · 128.
pub(crate) fn weight_magnitude_sum(row: &[u8]) -> u64 {
    u64::from(i8s(row).map(|weight| u32::from(weight.unsigned_abs())).sum::<u32>())
}
