//! What a model draws codes from, and how codes come from and go to hosts.
//!
//! In:  an action, a length, dials, random numbers; or floats.
//! Out: a [`Code`] to the decoder.
//!
//! Why here: the tables are `sampler.rs`'s affair; these are the questions that a program asks of them.

use super::{ActionId, Model};
use crate::code::Code;
use crate::dials::Dials;
use crate::error::SampleError;

impl<'a> Model<'a> {
    /// Shortest and longest trained motion of an action, in frames; both 0 when there is no such action.
    pub fn trained_frames(&self, action: ActionId) -> core::ops::RangeInclusive<u32> {
        self.sampler.trained_frames(action)
    }

    /// Draws the code of a new motion. Any generator serves: `&mut || rng.next_u32()`.
    ///
    /// # Errors
    /// [`SampleError`]: no such action, or a length that was never trained.
    pub fn sample(
        &self,
        action: ActionId,
        frames: u32,
        random: &mut impl FnMut() -> u32,
    ) -> Result<Code, SampleError> {
        let mut code = Code::new();
        self.sample_into(action, frames, random, &mut code)?;
        Ok(code)
    }

    /// [`sample`](Self::sample) without a second kilobyte of stack: into a code that lies where it is needed. After an
    /// error the code is as it was.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    pub fn sample_into(
        &self,
        action: ActionId,
        frames: u32,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) -> Result<(), SampleError> {
        self.sample_with(action, frames, Dials::NEUTRAL, random, code)
    }

    /// [`sample_into`](Self::sample_into) with the dials of intensity and variety turned.
    ///
    /// # Cost
    /// An intensity other than 1 reads all clips of the action once for every 16 numbers of a code.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    pub fn sample_with(
        &self,
        action: ActionId,
        frames: u32,
        dials: Dials,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) -> Result<(), SampleError> {
        self.sampler.sample(action, frames, dials.clamped(), random, code)
    }

    /// Whether [`sample`](Self::sample) would draw this motion.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    pub fn check_request(&self, action: ActionId, frames: u32) -> Result<(), SampleError> {
        self.sampler.check_request(action, frames)
    }

    /// A code from floats (β then α), rounded to nearest, saturated; numbers beyond the model's are dropped, missing
    /// ones are 0. For hosts: the device draws its codes with [`sample`](Self::sample).
    pub fn code_from_f32(&self, values: &[f32]) -> Code {
        let one = (1u32 << self.manifest.code_fraction_bits) as f32;
        let given = values.iter().copied().chain(core::iter::repeat(0.0));
        let round = |value: f32| {
            let scaled = value * one;
            (if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i16
        };
        let mut code = Code::new();
        code.append(given.take(self.code_count()).map(round));
        code
    }

    /// The numbers of a code (β then α) as floats, exact.
    pub fn code_to_f32(&self, code: &Code) -> impl Iterator<Item = f32> {
        let one = (1u32 << self.manifest.code_fraction_bits) as f32;
        code.values.clone().into_iter().map(move |value| f32::from(value) / one)
    }
}
