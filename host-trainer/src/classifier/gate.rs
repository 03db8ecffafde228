//! The two activations of a gated recurrent unit.
//!
//! Why here: 46,000 of them are taken for every motion that is scored, 50,000 motions in one evaluation. They rest on
//! the exponential of `float_model`, which has no call and no branch, so the compiler turns the loops into SIMD.

use crate::float_model::activation::exp_of_negative;

/// 1 / (1 + e⁻ˣ).
///
/// # Accuracy
/// 2e-7 absolute against f64 (asserted by `gates_stay_close_to_the_f64_reference`).
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    let power = exp_of_negative(-x.abs());
    let of_negative = power / (1.0 + power);
    let of_positive = if x.is_nan() { x } else { 1.0 - of_negative };
    if x < 0.0 { of_negative } else { of_positive }
}

/// Hyperbolic tangent.
///
/// # Accuracy
/// 2e-7 absolute against f64 (asserted by `gates_stay_close_to_the_f64_reference`).
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    let power = exp_of_negative(-2.0 * x.abs());
    let magnitude = (1.0 - power) / (1.0 + power);
    if x.is_nan() { x } else { magnitude.copysign(x) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_stay_close_to_the_f64_reference() {
        for step in -100_000..=100_000 {
            let x = step as f32 * 1e-3;
            let reference = 1.0 / (1.0 + (-f64::from(x)).exp());
            assert!((f64::from(sigmoid(x)) - reference).abs() < 2e-7, "{x}");
            assert!((f64::from(tanh(x)) - f64::from(x).tanh()).abs() < 2e-7, "{x}");
        }
    }

    #[test]
    fn gates_of_extremes_are_their_limits_and_of_nan_are_nan() {
        assert!(sigmoid(f32::NEG_INFINITY) < 1e-37 && sigmoid(f32::INFINITY) == 1.0);
        assert_eq!([f32::NEG_INFINITY, f32::INFINITY].map(tanh), [-1.0, 1.0]);
        assert!(tanh(f32::NAN).is_nan() && sigmoid(f32::NAN).is_nan());
    }
}
