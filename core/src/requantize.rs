//! Accumulator → next number format: one multiplication, one shift, one rounding.
//!
//! Source: gemmlowp's quantisation note for multiplier and shift; unlike gemmlowp the product is rounded once.

/// `real factor = word / 2^right`, where `right` is the word's own low six bits.
///
/// One word a row holds both: the multiplier has 31 bits, and a factor may be off by 2^-25 of itself without anyone
/// noticing, so its lowest six bits serve as the shift.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Requantizer(u32);

const RIGHT_BITS: u32 = 0x3F;

impl Requantizer {
    /// Shifts to the right: at least this many.
    pub const RIGHT_MIN: u32 = 1;
    /// Shifts to the right: at most this many.
    pub const RIGHT_MAX: u32 = 62;
    /// Shifts to the right that [`apply_narrow`](Self::apply_narrow) can do: at least this many.
    pub const NARROW_RIGHT_MIN: u32 = 33;

    /// A factor below 2^-27: every accumulator becomes 0 or its sign. For rows that only fill a block.
    pub const TINY: Self = Self(Self::RIGHT_MAX);

    /// From the stored word; `None` when its shift is out of range or its highest bit set.
    pub const fn from_bits(bits: u32) -> Option<Self> {
        let right = bits & RIGHT_BITS;
        if bits >> 31 != 0 || right < Self::RIGHT_MIN || right > Self::RIGHT_MAX {
            return None;
        }
        Some(Self(bits))
    }

    /// From a word that the loader has checked; of any other the result means nothing, but nothing worse happens.
    #[inline]
    pub(crate) const fn from_checked_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// The factor times a fraction in Q0.16, 0 to 65,536; never more than before, so whatever was proved of it holds.
    ///
    /// # Accuracy
    /// Rounded down by less than 2^-24 of the factor (asserted by `gated_factor_is_the_product`).
    pub(crate) const fn gated(self, fraction_q16: u32) -> Self {
        let multiplier = (self.0 >> 6) as u64 * fraction_q16 as u64;
        Self(((multiplier >> 16) as u32) << 6 | self.right())
    }

    /// The stored word.
    pub const fn to_bits(self) -> u32 {
        self.0
    }

    /// Shifts to the right.
    pub const fn right(self) -> u32 {
        self.0 & RIGHT_BITS
    }

    /// `round(accumulator · factor)`, ties towards +∞, saturated to `i32`.
    ///
    /// # Accuracy
    /// At most 0.5 of the output's unit from the exact product, 0.29 RMS
    /// (asserted by `requantize_rounds_to_nearest` and `requantize_error_is_uniform`).
    #[inline]
    pub const fn apply(self, accumulator: i32) -> i32 {
        // |accumulator · word| ≤ 2^31 · (2^31 − 1) and the rounding constant ≤ 2^61: the sum fits 64 bits.
        let product = (accumulator as i64).wrapping_mul(self.0.cast_signed() as i64);
        let half = 1i64 << (self.right().wrapping_sub(1) & RIGHT_BITS);
        let rounded = product.wrapping_add(half) >> self.right();
        if rounded > i32::MAX as i64 {
            i32::MAX
        } else if rounded < i32::MIN as i64 {
            i32::MIN
        } else {
            rounded as i32
        }
    }

    /// The same as [`apply`](Self::apply) for a shift of at least [`NARROW_RIGHT_MIN`](Self::NARROW_RIGHT_MIN), in a
    /// third of its instructions: the lower half of the product cannot change the result, and none can overflow.
    #[inline(always)]
    pub const fn apply_narrow(self, accumulator: i32) -> i32 {
        // A signed 32-bit product's upper half is one instruction where there is DSP.
        let product = (accumulator as i64).wrapping_mul(self.0.cast_signed() as i64);
        let high = (product >> 32) as i32;
        // Half of what is shifted out is added as a 1 between two shifts.
        let shifted = high >> (self.right().wrapping_sub(Self::NARROW_RIGHT_MIN) & 31);
        shifted.wrapping_add(1) >> 1
    }
}

#[cfg(test)]
mod tests {
    use super::Requantizer;
    use proptest::prelude::*;

    #[test]
    fn word_out_of_range_is_rejected() {
        assert_eq!(Requantizer::from_bits(1 << 31 | 40), None);
        assert_eq!(Requantizer::from_bits(1 << 30), None);
        assert_eq!(Requantizer::from_bits(1 << 30 | 63), None);
    }

    #[test]
    fn requantize_saturates_at_both_ends() {
        let double = Requantizer::from_bits(1 << 30 | 29).unwrap();
        assert_eq!(double.apply(i32::MAX), i32::MAX);
        assert_eq!(double.apply(i32::MIN), i32::MIN);
    }

    #[test]
    fn requantize_error_is_uniform() {
        let scale = Requantizer::from_bits((0x4CCC_CCC0 & !63) | 41).unwrap();
        let factor = f64::from(scale.to_bits()) / 2f64.powi(41);
        let (mut worst, mut sum, mut count) = (0.0f64, 0.0, 0.0);
        for accumulator in (i32::MIN..=i32::MAX).step_by(8191) {
            let error = f64::from(scale.apply(accumulator)) - f64::from(accumulator) * factor;
            (worst, sum, count) = (worst.max(error.abs()), sum + error * error, count + 1.0);
        }
        let rms = libm::sqrt(sum / count);
        assert!(worst <= 0.5 && rms <= 0.29, "max {worst}, RMS {rms}");
    }

    proptest! {
        #[test]
        fn requantize_rounds_to_nearest(
            accumulator: i32, multiplier in (1u32 << 24)..(1 << 25), right in 1u32..=62
        ) {
            let bits = multiplier << 6 | right;
            let got = Requantizer::from_bits(bits).unwrap().apply(accumulator);
            let product = i128::from(accumulator) * i128::from(bits);
            let twice_error = (product - (i128::from(got) << right)) * 2;
            let saturated = got == i32::MAX || got == i32::MIN;
            prop_assert!(saturated || twice_error.abs() <= 1 << right);
        }

        #[test]
        fn gated_factor_is_the_product(
            multiplier in (1u32 << 24)..(1 << 25), right in 1u32..=62, fraction in 0u32..=65_536
        ) {
            let whole = Requantizer::from_bits(multiplier << 6 | right).unwrap();
            let gated = whole.gated(fraction);
            let exact = f64::from(multiplier) * f64::from(fraction) / 65_536.0;
            let lost = exact - f64::from(gated.to_bits() >> 6);
            prop_assert!((0.0..1.0).contains(&lost) && gated.right() == right);
            prop_assert!(Requantizer::from_bits(gated.to_bits()).is_some());
        }

        #[test]
        fn narrow_form_gives_the_same_bits(
            accumulator: i32, multiplier in 0u32..(1 << 25), right in 33u32..=62
        ) {
            let requantizer = Requantizer::from_bits(multiplier << 6 | right).unwrap();
            prop_assert_eq!(requantizer.apply_narrow(accumulator), requantizer.apply(accumulator));
        }
    }
}
