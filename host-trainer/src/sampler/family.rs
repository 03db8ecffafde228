//! The samplers that the command `samplers` compares.
//!
//! In:  a checkpoint and its mixtures.
//! Out: samplers to the command `samplers`.

use super::StoredSampler;
use super::coding::Coding;
use super::interval_clips::IntervalClips;
use super::nearest_clips::{ClipOptions, NearestClips};
use super::stored_mixture::{Kept, StoredMixture};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::mixture::fit::fit;
use crate::mixture::set::MixtureSet;
use crate::mixture::{Covariance, MixtureConfig};

/// Which samplers are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Family {
    /// Clips nearest in length: window, step and noise
    Choice,
    /// Clips nearest in length: bits, residuals, k-means
    Coding,
    /// Clips by length interval, as blobs held them before
    Intervals,
    /// Mixtures: 1 to 15 components; full, shared, low-rank, diagonal covariances
    Mixtures,
}

/// Most components of a mixture.
const COMPONENT_COUNTS: [usize; 5] = [15, 10, 5, 3, 1];

/// All samplers of a family, in the order of the table.
///
/// # Errors
/// Those of fitting mixtures.
pub fn samplers<'a>(
    family: Family,
    checkpoint: &Checkpoint,
    mixtures: &'a MixtureSet,
) -> Result<Vec<Box<dyn StoredSampler + 'a>>> {
    Ok(match family {
        Family::Choice => choices(checkpoint),
        Family::Coding => codings(checkpoint),
        Family::Intervals => vec![Box::new(IntervalClips::new(checkpoint, mixtures))],
        Family::Mixtures => stored_mixtures(checkpoint)?,
    })
}

fn choices(checkpoint: &Checkpoint) -> Vec<Box<dyn StoredSampler>> {
    let of = |clip_count, step_max, noise| ClipOptions {
        clip_count,
        step_max,
        noise,
        ..ClipOptions::DEFAULT
    };
    let options = [
        of(1, 0.0, 1.0),
        of(5, 0.0, 1.0),
        of(8, 0.0, 1.0),
        of(8, 0.0, 0.5),
        of(8, 0.0, 1.5),
        of(8, 0.1, 1.0),
        of(8, 0.2, 1.0),
        of(8, 0.3, 1.0),
        of(8, 0.5, 1.0),
        of(12, 0.0, 1.0),
        of(20, 0.0, 1.0),
    ];
    let sampler = |options: ClipOptions| -> Box<dyn StoredSampler> {
        let coding = Coding::Columns { bits_mean: options.bits_mean };
        Box::new(NearestClips::new(checkpoint, coding, options))
    };
    options.map(sampler).into()
}

fn codings(checkpoint: &Checkpoint) -> Vec<Box<dyn StoredSampler>> {
    let bits =
        [8.0, 6.0, 5.0, 4.0, 3.5, 3.0, 2.5, 2.0].map(|bits_mean| Coding::Columns { bits_mean });
    let residual = [4.0, 3.0].map(|bits_mean| Coding::Residual { bits_mean });
    let product = [2, 3, 4].map(|dimensions| Coding::Product { dimensions });
    let sampler = |coding: Coding| -> Box<dyn StoredSampler> {
        Box::new(NearestClips::new(checkpoint, coding, ClipOptions::DEFAULT))
    };
    bits.into_iter().chain(residual).chain(product).map(sampler).collect()
}

fn stored_mixtures(checkpoint: &Checkpoint) -> Result<Vec<Box<dyn StoredSampler>>> {
    let mut samplers: Vec<Box<dyn StoredSampler>> = Vec::new();
    let config = &checkpoint.config;
    for components_max in COMPONENT_COUNTS {
        let mut fit_with = |covariance, kept: &[Kept]| -> Result<()> {
            let mixture = MixtureConfig { components_max, covariance, ..config.mixture.clone() };
            let set = fit(&checkpoint.sequence_codes, &checkpoint.dataset, &mixture, config.seed)?;
            for &kept in kept {
                samplers.push(Box::new(StoredMixture::new(&set, kept)?));
            }
            Ok(())
        };
        fit_with(Covariance::Full, &[Kept::Full, Kept::LowRank(2), Kept::Shared])?;
        fit_with(Covariance::Diagonal, &[Kept::Diagonal])?;
    }
    Ok(samplers)
}
