//! What the dial of variety makes of a blob's sampler.
//!
//! In:  the blob's largest step between clips; the dial.
//! Out: as many clips, as large a step and as much noise to `sampler.rs`.
//!
//! Why here: one dial for three quantities, so that a user turns temperature and not tables.

use crate::dials::Dials;
use crate::random::below;

/// The dial, and what follows from it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Variety {
    variety_q12: u16,
    pub step_max_q16: u32,
}

impl Variety {
    /// Largest step between clips that the dial adds at 2.
    const STEP_AT_TWO_Q16: u32 = 1 << 15;

    /// `step_max_q16`: the blob's, Q0.16.
    pub fn new(step_max_q16: u32, variety_q12: u16) -> Self {
        let less = u32::from(variety_q12.min(Dials::ONE_Q12));
        let more = u32::from(variety_q12.saturating_sub(Dials::ONE_Q12).min(Dials::ONE_Q12));
        let step_q16 = ((u64::from(step_max_q16) * u64::from(less)) >> 12) as u32;
        let wider_q16 = (Self::STEP_AT_TWO_Q16 * more) >> 12;
        Self { variety_q12, step_max_q16: step_q16.saturating_add(wider_q16).min(1 << 16) }
    }

    /// Clips to draw from where a blob at 1 has `clip_count`: rounded to nearest, at least one.
    pub fn clips(self, clip_count: u32) -> u32 {
        ((clip_count * u32::from(self.variety_q12) + (1 << 11)) >> 12).max(1)
    }

    /// A σ at this temperature: rounded down, saturated.
    pub fn sigma(self, sigma_q8: i32) -> i32 {
        let scaled = (i64::from(sigma_q8) * i64::from(self.variety_q12)) >> 12;
        scaled.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    /// Whether every number of a code is to be stretched by a factor of its own.
    pub fn stretches(self) -> bool {
        self.variety_q12 > Dials::ONE_Q12
    }

    /// A factor about 1, Q12: evenly from 0.4 to 1.6 where the dial is at 2, 1 where it is at 1 or below. In as many
    /// dimensions as a code has, no two draws come close to each other, even from one clip.
    pub fn stretch_q12(self, random: &mut impl FnMut() -> u32) -> i64 {
        if !self.stretches() {
            return 1 << 12;
        }
        let reach_q12 = (u32::from(self.variety_q12 - Dials::ONE_Q12) * 2458) >> 12;
        i64::from((1 << 12) - reach_q12 + below(2 * reach_q12 + 1, random))
    }
}
