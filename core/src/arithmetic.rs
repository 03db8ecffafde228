//! The seam between the decoder's equation and the two ways to compute it.

use crate::layer::Layer;

/// What `decoder.rs` needs of a number format; implemented by `Integer` and `Half`.
pub(crate) trait Arithmetic {
    /// Stored activation.
    type Value;
    /// Accumulator.
    type Sum;

    /// A sinusoid in Q0.15 as input of the time half.
    fn sinusoid(&self, q15: i16) -> Self::Value;

    /// `folded = weights · code + bias`, in accumulator units of the time half.
    fn fold(
        &self,
        code_half: &Layer<'_>,
        time_half: &Layer<'_>,
        code: &[i16],
        folded: &mut [Self::Sum],
    );

    /// `output = ELU(weights · input + folded)`.
    fn time_half(
        &self,
        layer: &Layer<'_>,
        input: &[Self::Value],
        folded: &[Self::Sum],
        output: &mut [Self::Value],
    );

    /// `output = ELU(weights · input + bias)`.
    fn hidden(&self, layer: &Layer<'_>, input: &[Self::Value], output: &mut [Self::Value]);

    /// `channels = weights · input + bias`, in channel units, Q15.16; `emit` takes them in order.
    fn output(&self, layer: &Layer<'_>, input: &[Self::Value], emit: impl FnMut(i32));
}
