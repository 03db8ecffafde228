//! The activation of every hidden layer: ELU with α = 1, in Q15.16.
//!
//! ELU(x) = x for x ≥ 0, e^x − 1 otherwise; e^x = 2^−k · 2^−f by one multiplication and a table over f.
//!
//! Source: Clevert et al., ICLR 2016; MotionINR's decoder uses it after every hidden layer.

/// Fraction bits of pre-activations and of ELU's result.
pub(crate) const FRACTION_BITS: u32 = 16;
const ONE: i32 = 1 << FRACTION_BITS;

/// `log2(e)` in Q2.30.
const LOG2_E: u64 = 1_549_082_005;

const STEPS: usize = 128;

/// `2^(−i/128)` in Q1.31.
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
        table[index] = (sum * 2_147_483_648.0 + 0.5) as u32;
        index += 1;
    }
    table
};

/// ELU of a pre-activation.
///
/// # Units and formats
/// In and out: Q15.16. Below −12 the result is −1 (e^−12 is less than half an LSB).
///
/// # Accuracy
/// Against f64 over every x in −13..=0: 0.76 LSB max, 0.30 LSB RMS of 2^-16
/// (asserted by `elu_error_over_the_whole_negative_domain`); exact for x ≥ 0.
#[inline]
pub(crate) fn elu(x: i32) -> i32 {
    if x >= 0 { x } else { exponential(x.unsigned_abs()) - ONE }
}

/// `e^−magnitude` in Q15.16, for a magnitude in Q16.16.
fn exponential(magnitude: u32) -> i32 {
    if magnitude >= 12 << FRACTION_BITS {
        return 0;
    }
    let power = ((u64::from(magnitude) * LOG2_E) >> 20) as u32; // Q6.26
    let (halvings, fraction) = (power >> 26, power & ((1 << 26) - 1));
    let index = (fraction >> 19) as usize;
    let within = fraction & ((1 << 19) - 1); // Q0.19
    let high = POWERS.get(index).copied().unwrap_or(0);
    let low = POWERS.get(index + 1).copied().unwrap_or(0);
    let fall = (u64::from(high.wrapping_sub(low)) * u64::from(within)) >> 19;
    let value = high.wrapping_sub(fall as u32);
    // Q1.31 → Q15.16 is 15 places; at most 18 halvings, so the shift stays below 34.
    let shift = halvings + 15;
    ((u64::from(value) + (1 << (shift - 1))) >> shift) as i32
}

#[cfg(test)]
mod tests {
    use super::{ONE, elu};

    #[test]
    fn elu_passes_positive_values() {
        for x in [0, 1, ONE, i32::MAX] {
            assert_eq!(elu(x), x);
        }
    }

    #[test]
    fn elu_ends_at_minus_one() {
        assert_eq!(elu(i32::MIN), -ONE);
        assert_eq!(elu(-12 * ONE), -ONE);
    }

    #[test]
    fn elu_is_monotonic() {
        assert!((-13 * ONE..0).all(|x| elu(x) <= elu(x + 1)));
    }

    #[test]
    fn elu_error_over_the_whole_negative_domain() {
        let (mut worst, mut sum) = (0.0f64, 0.0f64);
        for x in -13 * ONE..0 {
            let exact = libm::expm1(f64::from(x) / f64::from(ONE)) * f64::from(ONE);
            let error = f64::from(elu(x)) - exact;
            worst = worst.max(error.abs());
            sum += error * error;
        }
        let rms = libm::sqrt(sum / f64::from(13 * ONE));
        assert!(worst <= 0.76, "max {worst} LSB");
        assert!(rms <= 0.30, "RMS {rms} LSB");
    }
}
