//! Time → sinusoids: one 32-bit phase per frequency, random access, no drift.
//!
//! In:  a frame position; the phase step per frame of every frequency, from the blob.
//! Out: the input of the time half of layer 1.
//!
//! Source: MotionINR's table [sin(w_0 t), cos(w_0 t), sin(w_1 t), …]; here t may be fractional, as the paper says
//! and its code does not allow.

use crate::manifest::NumberFormat;
use crate::sine::sine_and_cosine_q15;

/// A point in a motion, in frames from its start: Q16.16, so fractions of a frame are allowed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct FramePosition(u32);

impl FramePosition {
    /// A whole frame (wraps at 65,536).
    pub const fn from_frames(frames: u32) -> Self {
        Self(frames << 16)
    }

    /// Frames in Q16.16.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Frames in Q16.16.
    pub const fn to_bits(self) -> u32 {
        self.0
    }

    /// Where a motion of `rate_millihz` poses per 1000 s is after `elapsed_us` microseconds; saturates.
    ///
    /// # Accuracy
    /// Truncated to 2^-16 of a frame, from the exact product: errors do not add up over ticks.
    pub fn after_us(elapsed_us: u32, rate_millihz: u32) -> Self {
        let product = u64::from(elapsed_us) * u64::from(rate_millihz);
        let (frames, rest) = (product / 1_000_000_000, product % 1_000_000_000);
        let frames_q16 = (frames << 16) + ((rest << 16) / 1_000_000_000);
        Self(u32::try_from(frames_q16).unwrap_or(u32::MAX))
    }

    /// The frame, where this is a whole one.
    pub(crate) const fn whole_frame(self) -> Option<u32> {
        if self.0 & 0xFFFF == 0 { Some(self.0 >> 16) } else { None }
    }

    /// Phase of a sinusoid that advances by `step` per frame; a turn is 2^32. Exact but for the
    /// bits below it, which are cut off.
    ///
    /// The 48 bits that count of a product of 64, piece by piece: a Cortex-M0+ has no wide product.
    const fn phase(self, step: u32) -> u32 {
        let (frames, fraction_q16) = (self.0 >> 16, self.0 & 0xFFFF);
        let whole = frames.wrapping_mul(step).wrapping_add(fraction_q16 * (step >> 16));
        whole.wrapping_add((fraction_q16 * (step & 0xFFFF)) >> 16)
    }
}

/// `[sin, cos]` of the frequency that advances by `step` (turns · 2^32) per frame, as a format stores them:
/// `NumberFormat::sinusoid_one` is 1, nearest, ties up.
#[inline]
pub fn stored_sinusoids(format: NumberFormat, position: FramePosition, step: u32) -> [i32; 2] {
    turned_sinusoids(format, position, step, 0)
}

/// The same, ahead by a phase (turns · 2^32).
#[inline]
pub(crate) fn turned_sinusoids(
    format: NumberFormat,
    position: FramePosition,
    step: u32,
    phase: u32,
) -> [i32; 2] {
    let one = i32::from(format.sinusoid_one());
    // Exact for one = 32,767 up to the rounding of (q15 · 32767 + 2^14) / 2^15 back to q15.
    let stored = |q15: i32| if one == 32_767 { q15 } else { (q15 * one + (1 << 14)) >> 15 };
    sinusoids(position, step, phase).map(stored)
}

/// `[sin, cos]` of the frequency that advances by `step` (turns · 2^32) per frame, ahead by `phase`, in Q0.15.
#[inline]
pub(crate) fn sinusoids(position: FramePosition, step: u32, phase: u32) -> [i32; 2] {
    sine_and_cosine_q15(position.phase(step).wrapping_add(phase))
}

#[cfg(test)]
mod tests {
    use super::{FramePosition, sinusoids};

    #[test]
    fn embedding_follows_the_paper_at_whole_and_fractional_frames() {
        for (pair, rate_rad) in [(0, 1.0), (1, 0.93), (2, 1e-4)] {
            let step = (rate_rad / core::f64::consts::TAU * 4_294_967_296.0) as u32;
            for bits in [0, 1 << 16, 470 << 16, (123 << 16) + 32_768, 4000 << 16] {
                let output = sinusoids(FramePosition::from_bits(bits), step, 1 << 30);
                let quarter = core::f64::consts::FRAC_PI_2;
                let angle = rate_rad * f64::from(bits) / 65_536.0 + quarter;
                let [sine, cosine] = output.map(|x| f64::from(x) / 32_767.0);
                assert!((sine - libm::sin(angle)).abs() < 4e-5, "pair {pair} at {bits}");
                assert!((cosine - libm::cos(angle)).abs() < 4e-5, "pair {pair} at {bits}");
            }
        }
    }

    #[test]
    fn phase_is_the_wide_product() {
        for bits in (0..u32::MAX).step_by(1_000_003) {
            for step in [1, 0xFFFF, 0x1_0000, 683_565_276, u32::MAX] {
                let wide = (u64::from(bits) * u64::from(step)) >> 16;
                assert_eq!(FramePosition::from_bits(bits).phase(step), wide as u32);
            }
        }
    }

    #[test]
    fn position_after_an_hour_is_exact() {
        let hour = FramePosition::after_us(3_600_000_000, 10_000);
        assert_eq!(hour, FramePosition::from_frames(36_000));
    }

    #[test]
    fn position_saturates() {
        assert_eq!(FramePosition::after_us(u32::MAX, u32::MAX).to_bits(), u32::MAX);
    }
}
