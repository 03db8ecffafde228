//! The activation of every hidden layer: ELU with α = 1, from pre-activation to stored activation.
//!
//! ELU(x) = x for x ≥ 0, e^x − 1 otherwise; e^x = 2^−k · 2^−f, a shift and a table over f.
//!
//! Why here: pre-activations come in units of the stored activation (or 1/256 of them), so that a positive one, which
//! is every second, is done after one shift. Only 32-bit products, because a Cortex-M0+ has no others.
//!
//! Source: Clevert et al., ICLR 2016; MotionINR's decoder uses it after every hidden layer.

use crate::manifest::{ActivationScale, NumberFormat};

const STEPS: usize = 128;

/// `2^(−i/128)` in Q16.
#[allow(clippy::indexing_slicing, reason = "the compiler evaluates it")]
const POWERS: [u32; STEPS + 1] = {
    let mut table = [0; STEPS + 1];
    let mut index = 0;
    while index <= STEPS {
        let x = core::f64::consts::LN_2 * index as f64 / STEPS as f64;
        let (mut sum, mut term, mut n) = (1.0, 1.0, 1.0);
        while n < 20.0 {
            term = -term * x / n;
            sum += term;
            n += 1.0;
        }
        table[index] = (sum * 65_536.0 + 0.5) as u32;
        index += 1;
    }
    table
};

/// Fraction bits of an exponent of 2, see [`one_minus_exp2`].
pub(crate) const POWER_BITS: u32 = 27;

/// `1 − 2^−power` in Q16, for a power in Q5.27.
///
/// # Accuracy
/// Against f64 over the whole domain: 1.7 LSB max, 0.45 LSB RMS of 2^-16
/// (asserted by `power_error_over_the_whole_domain`).
#[inline(always)]
pub(crate) fn one_minus_exp2(power: u32) -> u32 {
    let index = (power >> 20) as usize % STEPS;
    let within = (power >> 4) & 0xFFFF; // Q0.16
    let high = POWERS.get(index).copied().unwrap_or(0);
    let low = POWERS.get(index + 1).copied().unwrap_or(0);
    let value = high.wrapping_sub(high.wrapping_sub(low).wrapping_mul(within) >> 16);
    65_536 - (value >> (power >> POWER_BITS))
}

/// ELU of one layer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Elu {
    scale: ActivationScale,
    /// Largest magnitude whose power still fits 32 bits.
    magnitude_max: u32,
    range: (i32, i32),
}

impl Elu {
    /// Whether a stored scale is usable.
    pub fn is_valid(scale: &ActivationScale, format: NumberFormat) -> bool {
        let (low, high) = format.activation_range();
        scale.power_step != 0
            && scale.fraction_bits <= 8
            && scale.one < 1 << 15
            && scale.one_shift <= 30
            && (low..=high).contains(&scale.zero_point)
    }

    /// Of a scale that the loader has found valid; of any other the result means nothing, but nothing worse happens.
    pub fn new(scale: ActivationScale, format: NumberFormat) -> Self {
        let (low, high) = format.activation_range();
        let magnitude_max = u32::MAX.checked_div(scale.power_step).unwrap_or(0);
        Self { scale, magnitude_max, range: (i32::from(low), i32::from(high)) }
    }

    /// Stored activation of real 0.
    pub fn zero_point(&self) -> i32 {
        i32::from(self.scale.zero_point)
    }

    /// Stored activation of a pre-activation.
    ///
    /// # Units and formats
    /// In: units of the stored activation · 2^-fraction_bits, magnitude below 2^30. Out: stored, zero point included.
    ///
    /// # Accuracy
    /// Against f64, before clamping: 0.5 stored units for x ≥ 0; for x < 0, 1 unit + 2.2·2^-16 where a unit is at
    /// least 2^-13 (asserted by `elu_error_over_the_whole_domain`).
    #[inline(always)]
    pub fn apply(&self, x: i32) -> i32 {
        let bits = u32::from(self.scale.fraction_bits) & 15;
        // The zero point lies within the range, so each side can only leave it at one end.
        if x >= 0 {
            // The zero point among the bits that are shifted out saves an addition; below 2^30 + 2^24.
            let start = (self.zero_point() << bits).wrapping_add((1 << bits) >> 1);
            (x.wrapping_add(start) >> bits).min(self.range.1)
        } else {
            self.zero_point().wrapping_sub(self.fall(x.unsigned_abs())).max(self.range.0)
        }
    }

    /// `1 − e^−magnitude` in stored units.
    #[inline(always)]
    fn fall(&self, magnitude: u32) -> i32 {
        let power = magnitude.min(self.magnitude_max).wrapping_mul(self.scale.power_step);
        let shift = u32::from(self.scale.one_shift) & 31;
        // 2^16 · (2^15 − 1) + 2^29 fits 32 bits.
        let fall = one_minus_exp2(power).wrapping_mul(u32::from(self.scale.one));
        (fall.wrapping_add((1 << shift) >> 1) >> shift) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the quantiser stores for a unit of `unit`.
    fn scale(unit: f64, fraction_bits: u8) -> ActivationScale {
        let unit_of_pre_activation = unit / f64::from(1 << fraction_bits);
        let power_step = unit_of_pre_activation * core::f64::consts::LOG2_E * 134_217_728.0;
        let one_shift = 16 + 14 - libm::floor(libm::log2(1.0 / unit)) as i32;
        let one = libm::round(libm::exp2(f64::from(one_shift - 16)) / unit);
        ActivationScale {
            power_step: libm::round(power_step) as u32,
            one: one.min(32_767.0) as u16,
            one_shift: one_shift as u8,
            zero_point: 0,
            fraction_bits,
        }
    }

    #[test]
    fn unusable_scale_is_rejected() {
        let good = scale(1e-3, 0);
        let bad = [
            ActivationScale { power_step: 0, ..good },
            ActivationScale { one: 1 << 15, ..good },
            ActivationScale { one_shift: 31, ..good },
            ActivationScale { fraction_bits: 9, ..good },
        ];
        assert!(Elu::is_valid(&good, NumberFormat::W8A16));
        for scale in bad {
            assert!(!Elu::is_valid(&scale, NumberFormat::W8A16), "{scale:?}");
        }
        let far = ActivationScale { zero_point: 128, ..good };
        assert!(!Elu::is_valid(&far, NumberFormat::W8A8));
    }

    #[test]
    fn elu_saturates_at_both_ends() {
        let elu = Elu::new(scale(1e-3, 0), NumberFormat::W8A16);
        assert_eq!(elu.apply(1 << 30), 32_767);
        assert_eq!(elu.apply(-(1 << 30)), -1000);
        assert_eq!(elu.apply(i32::MIN), -1000);
    }

    #[test]
    fn power_error_over_the_whole_domain() {
        let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0.0);
        for power in (0..=u32::MAX).step_by(997) {
            let exact = 65_536.0 * (1.0 - libm::exp2(-f64::from(power) / 134_217_728.0));
            let error = f64::from(one_minus_exp2(power)) - exact;
            (worst, sum, count) = (worst.max(error.abs()), sum + error * error, count + 1.0);
        }
        let rms = libm::sqrt(sum / count);
        assert!(worst <= 1.7 && rms <= 0.45, "max {worst} LSB, RMS {rms} LSB");
    }

    #[test]
    fn elu_error_over_the_whole_domain() {
        for (unit, bits) in [(1.0 / 8192.0, 0), (3e-4, 0), (1e-3, 0), (0.011, 8), (0.08, 8)] {
            let format = if bits == 0 { NumberFormat::W8A16 } else { NumberFormat::W8A8 };
            let elu = Elu::new(scale(unit, bits), format);
            let fine = unit / f64::from(1 << bits);
            let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0.0);
            let lowest = -(14.0 / fine) as i32;
            for x in lowest..=(f64::from(elu.range.1) * f64::from(1 << bits)) as i32 {
                let real = f64::from(x) * fine;
                let exact = if x >= 0 { real } else { libm::expm1(real) };
                if exact / unit < f64::from(elu.range.0) {
                    continue;
                }
                let error = f64::from(elu.apply(x)) - exact / unit;
                (worst, sum, count) = (worst.max(error.abs()), sum + error * error, count + 1.0);
            }
            let rms = libm::sqrt(sum / count);
            let allowed = 1.0 + 2.2 / 65_536.0 / unit;
            assert!(worst <= allowed, "unit {unit}: max {worst}, allowed {allowed}");
            assert!(rms <= 0.5 * allowed, "unit {unit}: RMS {rms}");
        }
    }
}
