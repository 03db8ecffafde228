//! `w8a16` and `w8a8`: i8 weights, i32 accumulators, nothing but integers.
//!
//! Why here: the same bits on every machine follow from integer arithmetic with one stated rounding. Wrapping sums are
//! safe because the loader has proved for every row that they do not wrap.

use crate::arithmetic::Arithmetic;
use crate::elu::elu;
use crate::layer::{Layer, input_magnitude_max, weight_magnitude_sum};
use crate::little_endian::i32s;
use crate::manifest::{NumberFormat, TIME_LAYER};

/// The integer formats; they differ in the range of activations alone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Integer(pub NumberFormat);

impl Arithmetic for Integer {
    type Value = i16;
    type Sum = i32;

    fn sinusoid(&self, q15: i16) -> i16 {
        let one = i32::from(self.0.sinusoid_one());
        // Exact for one = 32,767 up to the rounding of (q15 · 32767 + 2^14) / 2^15 back to q15.
        if one == 32_767 { q15 } else { ((i32::from(q15) * one + (1 << 14)) >> 15) as i16 }
    }

    fn fold(&self, code_half: &Layer<'_>, time_half: &Layer<'_>, code: &[i16], folded: &mut [i32]) {
        let input_max = input_magnitude_max(TIME_LAYER, self.0);
        let rows = code_half.rows().zip(i32s(code_half.bias)).zip(code_half.requantizers());
        for ((folded, ((row, bias), requantizer)), time_row) in
            folded.iter_mut().zip(rows).zip(time_half.rows())
        {
            // What the time half can add at most, so that their sum stays inside the accumulator.
            let room =
                i32::MAX - (weight_magnitude_sum(time_row) * input_max).min(i32::MAX as u64) as i32;
            *folded = requantizer.apply(dot(row, code, bias)).clamp(-room, room);
        }
    }

    fn time_half(&self, layer: &Layer<'_>, input: &[i16], folded: &[i32], output: &mut [i16]) {
        self.dense_elu(layer, input, folded.iter().copied(), output);
    }

    fn hidden(&self, layer: &Layer<'_>, input: &[i16], output: &mut [i16]) {
        self.dense_elu(layer, input, i32s(layer.bias), output);
    }

    fn output(&self, layer: &Layer<'_>, input: &[i16], mut emit: impl FnMut(i32)) {
        for ((row, bias), requantizer) in
            layer.rows().zip(i32s(layer.bias)).zip(layer.requantizers())
        {
            emit(requantizer.apply(dot(row, input, bias)));
        }
    }
}

impl Integer {
    fn dense_elu(
        &self,
        layer: &Layer<'_>,
        input: &[i16],
        starts: impl Iterator<Item = i32>,
        output: &mut [i16],
    ) {
        let (low, high) = self.0.activation_range();
        let (low, high) = (i32::from(low), i32::from(high));
        let zero_point = i32::from(layer.shape.activation.zero_point);
        let rows = layer.rows().zip(starts).zip(layer.requantizers());
        for (output, ((row, start), requantizer)) in output.iter_mut().zip(rows) {
            let pre_activation = requantizer.apply(dot(row, input, start));
            let stored = layer.activation.apply(elu(pre_activation)).saturating_add(zero_point);
            *output = stored.clamp(low, high) as i16;
        }
    }
}

/// `start + Σ w·x` over a row of i8 weights.
#[inline]
fn dot(row: &[u8], input: &[i16], start: i32) -> i32 {
    let products = row.iter().zip(input).map(|(&w, &x)| i32::from(w.cast_signed()) * i32::from(x));
    products.fold(start, i32::wrapping_add)
}
