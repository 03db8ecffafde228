//! Accumulator → next number format: one multiplication, one shift, one rounding.
//!
//! Source: gemmlowp's quantisation note for multiplier and shift; unlike gemmlowp the product is rounded once.

/// `real factor = multiplier / 2^31 · 2^shift`, with `multiplier` in 2^30..2^31 (or 0) and a positive shift to the
/// left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Requantizer {
    multiplier: i32,
    shift: i8,
}

impl Requantizer {
    /// Smallest shift: factors below 2^-32 round every accumulator to zero anyway.
    pub const SHIFT_MIN: i8 = -31;
    /// Largest shift.
    pub const SHIFT_MAX: i8 = 30;

    /// The factor 0.
    pub const ZERO: Self = Self { multiplier: 0, shift: 0 };

    /// Joins the stored parts; `None` when the shift is out of range or the multiplier negative.
    pub const fn new(multiplier: i32, shift: i8) -> Option<Self> {
        if multiplier < 0 || shift < Self::SHIFT_MIN || shift > Self::SHIFT_MAX {
            return None;
        }
        Some(Self { multiplier, shift })
    }

    /// The stored parts: multiplier (Q0.31), shift.
    pub const fn parts(self) -> (i32, i8) {
        (self.multiplier, self.shift)
    }

    /// `round(accumulator · factor)`, ties towards +∞, saturated to `i32`.
    ///
    /// # Accuracy
    /// At most 0.5 of the output's unit from the exact product (asserted by `requantize_rounds_to_nearest`).
    #[inline]
    pub const fn apply(self, accumulator: i32) -> i32 {
        // |accumulator · multiplier| ≤ 2^31 · (2^31 − 1) and the rounding constant ≤ 2^61: the sum fits 64 bits.
        let right = (31 - self.shift as i32) as u32;
        let product = (accumulator as i64).wrapping_mul(self.multiplier as i64);
        let rounded = product.wrapping_add(1 << (right - 1)) >> right;
        if rounded > i32::MAX as i64 {
            i32::MAX
        } else if rounded < i32::MIN as i64 {
            i32::MIN
        } else {
            rounded as i32
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Requantizer;
    use proptest::prelude::*;

    #[test]
    fn shift_out_of_range_is_rejected() {
        assert_eq!(Requantizer::new(1 << 30, 31), None);
        assert_eq!(Requantizer::new(1 << 30, -32), None);
        assert_eq!(Requantizer::new(-1, 0), None);
    }

    #[test]
    fn requantize_saturates_at_both_ends() {
        let double = Requantizer::new(1 << 30, 2).unwrap();
        assert_eq!(double.apply(i32::MAX), i32::MAX);
        assert_eq!(double.apply(i32::MIN), i32::MIN);
    }

    proptest! {
        #[test]
        fn requantize_rounds_to_nearest(
            accumulator: i32, multiplier in (1 << 30)..=i32::MAX, shift in -31i8..=30
        ) {
            let got = Requantizer::new(multiplier, shift).unwrap().apply(accumulator);
            let right = 31 - i32::from(shift);
            let product = i128::from(accumulator) * i128::from(multiplier);
            let twice_error = (product - (i128::from(got) << right)) * 2;
            let saturated = got == i32::MAX || got == i32::MIN;
            prop_assert!(saturated || twice_error.abs() <= 1 << right);
        }
    }
}
