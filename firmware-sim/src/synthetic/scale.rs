//! Scales of a synthetic model: how real values are stored in each number format.
//!
//! Source: `host-trainer/src/quantize/scale.rs`, for the stored forms. Powers of two are found by counting, because a
//! logarithm may differ from machine to machine in its last place.

use karakuri::NumberFormat;
use karakuri::manifest::{ActivationScale, CODE_LAYER, TIME_LAYER, WeightFormat};

/// Fraction bits of the codes.
pub const CODE_FRACTION_BITS: u8 = 11;
/// Real range of activations: ELU never falls below −1, and few sums of spread 1 exceed 4.
const ACTIVATION_RANGE: [f64; 2] = [-1.0, 4.0];

/// `real = scale · (stored − zero_point)`.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Real value of 1.
    pub scale: f64,
    /// Stored value of 0.
    pub zero_point: i16,
}

/// Whether activations have 8 bits.
pub fn takes_bytes(format: NumberFormat) -> bool {
    format.activation_range().1 == 127
}

/// Of the inputs of a layer.
pub fn input_scale(index: usize, weights: WeightFormat, format: NumberFormat) -> Scale {
    let code = 1.0 / f64::from(1 << CODE_FRACTION_BITS);
    match index {
        // 4-bit weights take the upper byte of a code, and the lower one as a fraction.
        CODE_LAYER if weights == WeightFormat::I4 => Scale { scale: 256.0 * code, zero_point: 0 },
        CODE_LAYER => Scale { scale: code, zero_point: 0 },
        TIME_LAYER => Scale { scale: 1.0 / f64::from(format.sinusoid_one()), zero_point: 0 },
        _ => activation_scale(format),
    }
}

/// Real value of 1 of a pre-activation.
pub fn pre_activation_scale(format: NumberFormat) -> f64 {
    activation_scale(format).scale / f64::from(1 << fraction_bits(format))
}

/// How the ELU of a hidden layer is stored.
pub fn elu_scale(format: NumberFormat) -> ActivationScale {
    if format == NumberFormat::F16 {
        return ActivationScale::NONE;
    }
    let Scale { scale, zero_point } = activation_scale(format);
    let power_step = pre_activation_scale(format) * std::f64::consts::LOG2_E * 134_217_728.0;
    // 1 / scale as a number below 2^15 and a shift.
    let (mut one, mut one_shift) = (1.0 / scale, 16);
    while 2.0 * one < 32_767.5 {
        (one, one_shift) = (2.0 * one, one_shift + 1);
    }
    ActivationScale {
        power_step: power_step.round() as u32,
        one: one.round() as u16,
        one_shift,
        zero_point,
        fraction_bits: fraction_bits(format),
    }
}

/// The word of a `Requantizer` for a factor below 2^29: its lowest six bits are the shift to the right.
pub fn word_of(factor: f64) -> u32 {
    let (mut scaled, mut right) = (2.0 * factor, 1);
    while 2.0 * scaled < 2_147_483_584.0 && right < 62 {
        (scaled, right) = (2.0 * scaled, right + 1);
    }
    ((scaled - f64::from(right)) / 64.0).round() as u32 * 64 + right
}

/// Symmetric where there are steps to spare, else the whole range of the format.
fn activation_scale(format: NumberFormat) -> Scale {
    let (low, high) = format.activation_range();
    let [min, max] = ACTIVATION_RANGE;
    if !takes_bytes(format) {
        return Scale { scale: max / f64::from(high), zero_point: 0 };
    }
    let scale = (max - min) / (f64::from(high) - f64::from(low));
    Scale { scale, zero_point: (f64::from(low) - min / scale).round() as i16 }
}

fn fraction_bits(format: NumberFormat) -> u8 {
    if takes_bytes(format) { 8 } else { 0 }
}
