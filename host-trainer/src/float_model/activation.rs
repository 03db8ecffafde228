//! The exponential linear unit: ELU(x) = x for x > 0, eˣ − 1 otherwise.
//!
//! Why here: a network of paper size takes 2,300 exponentials a row, and the C library's one at a time would cost a
//! tenth of the training time. This one has no branch and no call, so the compiler turns the loop into SIMD.
//!
//! Source: Clevert et al. 2016; exponential by Cody–Waite reduction and a degree 6 Taylor polynomial.

/// Applies ELU.
///
/// # Accuracy
/// 2e-7 absolute against f64 (asserted by `elu_stays_close_to_the_f64_reference`).
#[inline(always)]
pub fn elu(x: f32) -> f32 {
    let negative = exp_of_negative(x.min(0.0)) - 1.0;
    if x < 0.0 { negative } else { x }
}

/// Slope of ELU, from its output: 1 above 0, `output + 1` = eˣ below.
#[inline(always)]
pub fn elu_slope(output: f32) -> f32 {
    output.min(0.0) + 1.0
}

/// eˣ for x ≤ 0; below −87 as at −87, which is 0 for every purpose here.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
    /// Adding 1.5 · 2²³ leaves the nearest integer in the low mantissa bits.
    const ROUNDER: f32 = 12_582_912.0;
    /// ln 2 in two parts; the first has so few bits that n · LN_2_HIGH is exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    const MANTISSA_BITS: u32 = 23;
    const EXPONENT_BIAS: u32 = 127;

    let x = x.max(-87.0);
    let rounded = x * core::f32::consts::LOG2_E + ROUNDER;
    let n = rounded - ROUNDER;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let polynomial = 1.0
        + r * (1.0
            + r * (1.0 / 2.0
                + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0))))));
    let n_bits = rounded.to_bits().wrapping_sub(ROUNDER.to_bits());
    let two_to_n = f32::from_bits(n_bits.wrapping_add(EXPONENT_BIAS) << MANTISSA_BITS);
    polynomial * two_to_n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elu_stays_close_to_the_f64_reference() {
        for step in -200_000..=50_000 {
            let x = step as f32 * 1e-3;
            let reference = if x > 0.0 { f64::from(x) } else { f64::from(x).exp() - 1.0 };
            assert!((f64::from(elu(x)) - reference).abs() < 2e-7, "{x}");
        }
    }

    #[test]
    fn elu_of_extremes_is_finite_and_of_nan_is_nan() {
        assert_eq!(elu(f32::NEG_INFINITY), -1.0);
        assert_eq!(elu(0.0), 0.0);
        assert!(elu(f32::NAN).is_nan());
    }
}
