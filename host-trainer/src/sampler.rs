//! Samplers that are small enough for flash: (action, length, random numbers) → sequence code, and how many bytes they
//! take.
//!
//! In:  the code tables of a checkpoint, for mixtures also their fits.
//! Out: [`StoredSampler`]s over stored (rounded) numbers, to `evaluate`, `generate` and the command `samplers`; the one
//!      that won, and two others, to `quantize`.
//!
//! Why here: mixtures of full covariances are many times larger than the decoder that they feed. What a blob stores is
//! decided by measuring every family over the same decoder, at the precision at which it would be stored.
//!
//! Source: Cervantes et al., ECCV 2022, Algorithm 1, for mixtures by action and length; everything else is ours.

pub mod column;
pub mod coding;
pub mod nearest_clips;
pub mod interval_clips;
pub mod stored_mixture;
pub mod family;

use coding::Coding;
use interval_clips::IntervalClips;
use nearest_clips::{ClipOptions, NearestClips};
use stored_mixture::{Kept, StoredMixture};

use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::evaluate::source::CodeSampler;
use crate::mixture::set::MixtureSet;

/// How a blob draws codes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SamplerChoice {
    /// See [`nearest_clips`].
    NearestClips(ClipOptions),
    /// See [`interval_clips`].
    ClipCodes,
    /// The run's mixtures with diagonal covariances.
    DiagonalMixture,
}

/// A sampler as a blob would hold it.
pub trait StoredSampler: CodeSampler {
    /// Bytes of its tables.
    fn bytes(&self) -> usize;
}

/// A sampler of a run's codes as a blob would hold it.
///
/// # Errors
/// Those of [`stored_mixture::StoredMixture::new`].
pub fn build<'a>(
    choice: SamplerChoice,
    checkpoint: &Checkpoint,
    mixtures: &'a MixtureSet,
) -> Result<Box<dyn StoredSampler + 'a>> {
    Ok(match choice {
        SamplerChoice::NearestClips(options) => {
            let coding = Coding::Columns { bits_mean: options.bits_mean };
            Box::new(NearestClips::new(checkpoint, coding, options))
        }
        SamplerChoice::ClipCodes => Box::new(IntervalClips::new(checkpoint, mixtures)),
        SamplerChoice::DiagonalMixture => Box::new(StoredMixture::new(mixtures, Kept::Diagonal)?),
    })
}

/// Means of the clips' codes. // (clip)(dimension)
pub fn code_rows(checkpoint: &Checkpoint) -> Vec<Vec<f64>> {
    let codes = &checkpoint.sequence_codes;
    let rows = codes.mean.chunks_exact(codes.dimension_count);
    rows.map(|row| row.iter().map(|&x| f64::from(x)).collect()).collect()
}
