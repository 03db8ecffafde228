//! Flags of every verb that draws codes by a sampler that fits flash.

use std::path::Path;

use clap::ValueEnum;

use crate::checkpoint::Checkpoint;
use crate::error::{Error, Result};
use crate::mixture::set::MixtureSet;
use crate::sampler::nearest_clips::ClipOptions;
use crate::sampler::{self, SamplerChoice, StoredSampler};

/// Samplers by their command-line names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SamplerArg {
    /// Codes of the clips that are nearest in length, moved a little towards each other, with one shared noise.
    NearestClips,
    /// The same among the clips of a length interval, at one byte a number.
    ClipCodes,
    /// Gaussians with diagonal covariances, at one byte a number.
    DiagonalMixture,
}

impl SamplerArg {
    /// With the flags of `nearest-clips`.
    pub fn choice(self, clips: &ClipArgs) -> SamplerChoice {
        match self {
            Self::NearestClips => SamplerChoice::NearestClips(clips.options()),
            Self::ClipCodes => SamplerChoice::ClipCodes,
            Self::DiagonalMixture => SamplerChoice::DiagonalMixture,
        }
    }
}

/// Flags of verbs that take a run or a blob.
#[derive(Clone, Debug, clap::Args)]
pub struct RunSamplerArgs {
    /// Draw the codes of a run as a blob with this sampler would; without it, from the run's mixtures. A blob has its
    /// own.
    #[arg(long, value_enum)]
    pub sampler: Option<SamplerArg>,
    /// How clips become motions.
    #[command(flatten)]
    pub clips: ClipArgs,
}

impl RunSamplerArgs {
    /// For a blob: refuses a sampler.
    ///
    /// # Errors
    /// A sampler was asked for.
    pub fn check_none(&self, blob: &Path) -> Result<()> {
        let Some(sampler) = self.sampler else { return Ok(()) };
        let name =
            sampler.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
        Err(Error::bad_input(
            blob,
            "--sampler",
            name,
            "the folder of a run",
            "quantise the run with this sampler, or leave the flag out",
        ))
    }

    /// For a run: what draws its codes.
    ///
    /// # Errors
    /// Those of [`sampler::build`].
    pub fn build<'a>(
        &self,
        checkpoint: &Checkpoint,
        mixtures: &'a MixtureSet,
    ) -> Result<Option<Box<dyn StoredSampler + 'a>>> {
        let build = |arg: SamplerArg| sampler::build(arg.choice(&self.clips), checkpoint, mixtures);
        self.sampler.map(build).transpose()
    }
}

/// Flags of `nearest-clips`.
#[derive(Clone, Debug, clap::Args)]
pub struct ClipArgs {
    /// nearest-clips: bits of a number of a clip's code, on average; more go where they matter.
    #[arg(long, value_name = "BITS", default_value_t = ClipOptions::DEFAULT.bits_mean, value_parser = bits)]
    pub code_bits: f64,
    /// nearest-clips: clips of nearest length that a motion is drawn from.
    #[arg(long, value_name = "CLIPS", default_value_t = ClipOptions::DEFAULT.clip_count as u16,
        value_parser = clap::value_parser!(u16).range(1..))]
    pub nearest: u16,
    /// nearest-clips: largest step from one of them towards another, as a share of the way.
    #[arg(long, value_name = "SHARE", default_value_t = ClipOptions::DEFAULT.step_max, value_parser = share)]
    pub step: f64,
}

impl Default for ClipArgs {
    fn default() -> Self {
        let ClipOptions { clip_count, step_max, bits_mean, .. } = ClipOptions::DEFAULT;
        Self { code_bits: bits_mean, nearest: clip_count as u16, step: step_max }
    }
}

impl ClipArgs {
    /// As the sampler takes them.
    pub fn options(&self) -> ClipOptions {
        ClipOptions {
            clip_count: usize::from(self.nearest),
            step_max: self.step,
            bits_mean: self.code_bits,
            ..ClipOptions::DEFAULT
        }
    }
}

fn bits(text: &str) -> std::result::Result<f64, String> {
    number_in(text, 0.5, 8.0)
}

fn share(text: &str) -> std::result::Result<f64, String> {
    number_in(text, 0.0, 1.0)
}

fn number_in(text: &str, least: f64, largest: f64) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (least..=largest).contains(number));
    number.ok_or_else(|| format!("expected a number from {least} to {largest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_out_of_range_are_refused() {
        for text in ["0", "8.1", "NaN", "-1", "x"] {
            assert!(bits(text).is_err(), "{text}");
        }
        for text in ["-0.1", "1.1", "inf"] {
            assert!(share(text).is_err(), "{text}");
        }
        assert_eq!((bits("3.5"), share("0")), (Ok(3.5), Ok(0.0)));
    }
}
