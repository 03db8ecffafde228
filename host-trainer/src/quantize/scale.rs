//! Station 6c: real factors → the words and small numbers that the device multiplies by.

use std::f64::consts::LOG2_E;

use karakuri::Requantizer;
use karakuri::manifest::ActivationScale;

use crate::quantize::layer::InputScale;

/// The stored form of a real factor: the nearest word.
///
/// Factors below 2^-32 lose precision; factors of 2^30 and more saturate (no scale of a trained model is near them).
///
/// # Accuracy
/// Within 2^-25 of the factor where it is at least 2^-32 (asserted by `word_is_within_a_part_in_ten_million`).
pub fn requantizer_of(factor: f64) -> Requantizer {
    if !factor.is_finite() || factor <= 0.0 {
        return Requantizer::TINY;
    }
    let (right_min, right_max) = (Requantizer::RIGHT_MIN as i32, Requantizer::RIGHT_MAX as i32);
    let mut right = (30 - factor.log2().floor() as i32).clamp(right_min, right_max);
    loop {
        // The low six bits are the shift itself.
        let sixty_fourths = (factor * 2f64.powi(right) - f64::from(right)) / 64.0;
        let word = sixty_fourths.round().max(0.0) * 64.0 + f64::from(right);
        if word < 2f64.powi(31) || right == right_min {
            let largest = f64::from(i32::MAX & !63) + f64::from(right);
            return Requantizer::from_bits(word.min(largest) as u32).unwrap_or(Requantizer::TINY);
        }
        right -= 1;
    }
}

/// How a layer's ELU is computed when its outputs are stored as `next`, with pre-activations in units of
/// `next.scale / 2^fraction_bits`.
pub fn elu_scale(next: &InputScale, fraction_bits: u8) -> ActivationScale {
    let pre_activation_unit = next.scale / f64::from(1u32 << fraction_bits);
    let power_step = (pre_activation_unit * LOG2_E * 2f64.powi(27)).round();
    let one = 1.0 / next.scale;
    // `one` is stored as a number below 2^15 and a shift.
    let one_shift = (30.0 - one.log2().floor()).clamp(0.0, 30.0);
    let stored_one = (one * 2f64.powf(one_shift - 16.0)).round().min(32_767.0);
    ActivationScale {
        power_step: power_step.clamp(1.0, f64::from(u32::MAX)) as u32,
        one: stored_one as u16,
        one_shift: one_shift as u8,
        zero_point: next.zero_point,
        fraction_bits,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stored_one_is_the_unit_turned_over() {
        for scale in [3e-5, 1e-4, 3e-4, 0.011, 0.08, 1.0] {
            let stored = elu_scale(&InputScale { scale, zero_point: 0, magnitude_max: 127 }, 8);
            let one = f64::from(stored.one) / 2f64.powi(i32::from(stored.one_shift) - 16);
            // Below 1 it keeps 15 bits; the shift stops at 30, so a coarser unit leaves fewer.
            let rounding = 0.51 / f64::from(stored.one);
            assert!((one * scale - 1.0).abs() < rounding, "{scale}: {stored:?}");
            assert!(scale > 1.0 || stored.one >= 1 << 14, "{scale}: {stored:?}");
        }
    }

    proptest! {
        #[test]
        fn word_is_within_a_part_in_ten_million(exponent in -31.0f64..28.0) {
            let factor = 2f64.powf(exponent);
            let stored = requantizer_of(factor);
            let value = f64::from(stored.to_bits()) / 2f64.powi(stored.right() as i32);
            prop_assert!((value / factor - 1.0).abs() < 1e-7, "{factor} became {value}");
        }
    }
}
