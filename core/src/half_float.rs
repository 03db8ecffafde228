//! `f16`: binary16 weights, f32 activations and accumulators; for parts with an FPU.
//!
//! # Accuracy
//! Every operation is an IEEE operation in a stated order (no fused multiply-add), and `expm1f` is libm's portable one,
//! so hosts and Cortex-M agree to the last bit wherever they follow IEEE 754 for f32; parity runs state the bound.

use crate::arithmetic::Arithmetic;
use crate::layer::Layer;
use crate::little_endian::{i32s, u16s};

/// The f16 format; knows the code format.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Half {
    /// Value of 1 LSB of a code.
    pub code_unit: f32,
}

/// Partial sums of a row: enough for SIMD on a host, few enough for registers on a chip.
const LANES: usize = 4;

impl Arithmetic for Half {
    type Value = f32;
    type Sum = f32;

    fn sinusoid(&self, q15: i16) -> f32 {
        f32::from(q15) * (1.0 / 32_767.0)
    }

    fn fold(
        &self,
        code_half: &Layer<'_>,
        _time_half: &Layer<'_>,
        code: &[i16],
        folded: &mut [f32],
    ) {
        for ((folded, row), bias) in
            folded.iter_mut().zip(rows(code_half)).zip(f32s(code_half.bias))
        {
            let values = code.iter().map(|&value| f32::from(value) * self.code_unit);
            *folded = weights(row).zip(values).fold(bias, |sum, (w, x)| sum + w * x);
        }
    }

    fn time_half(&self, layer: &Layer<'_>, input: &[f32], folded: &[f32], output: &mut [f32]) {
        for ((output, row), &start) in output.iter_mut().zip(rows(layer)).zip(folded) {
            *output = elu(dot(row, input, start));
        }
    }

    fn hidden(&self, layer: &Layer<'_>, input: &[f32], output: &mut [f32]) {
        for ((output, row), bias) in output.iter_mut().zip(rows(layer)).zip(f32s(layer.bias)) {
            *output = elu(dot(row, input, bias));
        }
    }

    fn output(&self, layer: &Layer<'_>, input: &[f32], mut emit: impl FnMut(i32)) {
        for (row, bias) in rows(layer).zip(f32s(layer.bias)) {
            // `as` saturates, so that even an absurd weight cannot do more than reach the end of the range.
            let scaled = dot(row, input, bias) * 65_536.0;
            emit((if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i32);
        }
    }
}

fn elu(x: f32) -> f32 {
    if x >= 0.0 { x } else { libm::expm1f(x) }
}

fn rows<'a>(layer: &Layer<'a>) -> impl Iterator<Item = &'a [u8]> + use<'a> {
    layer.weights.chunks_exact(2 * layer.input_count())
}

fn weights(row: &[u8]) -> impl Iterator<Item = f32> + '_ {
    u16s(row).map(|bits| half::f16::from_bits(bits).to_f32())
}

fn f32s(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    i32s(bytes).map(|bits| f32::from_bits(bits.cast_unsigned()))
}

/// `start + Σ w·x`, in [`LANES`] partial sums that are added pairwise at the end, then the remainder in order.
#[inline]
fn dot(row: &[u8], input: &[f32], start: f32) -> f32 {
    let (row_chunks, input_chunks) = (row.chunks_exact(2 * LANES), input.chunks_exact(LANES));
    let tail = weights(row_chunks.remainder()).zip(input_chunks.remainder());
    let mut sums = [0.0f32; LANES];
    for (row, input) in row_chunks.zip(input_chunks) {
        for ((sum, weight), &x) in sums.iter_mut().zip(weights(row)).zip(input) {
            *sum += weight * x;
        }
    }
    let [a, b, c, d] = sums;
    tail.fold(start + ((a + b) + (c + d)), |sum, (weight, &x)| sum + weight * x)
}
