//! The flags by which every verb asks for new motions, and the motions.
//!
//! In:  a run or a blob, an action, a length, seeds.
//! Out: [`Motion`]s to `generate` and `bake`.

use std::path::PathBuf;

use crate::checkpoint::Checkpoint;
use crate::commands::sampler_args::RunSamplerArgs;
use crate::error::{Error, Result};
use crate::evaluate::source::CodeSampler;
use crate::export::Motion;
use crate::generate::{Request, generate_blob, generate_float};
use crate::import::check_rate;
use crate::inspect::blob::{load, read_blob};
use crate::mixture;

/// What to move, and how often.
#[derive(Clone, Debug, clap::Args)]
pub struct MotionArgs {
    /// Folder of a run (float model) or a blob (the device's own arithmetic).
    #[arg(value_name = "RUN|FILE.kara")]
    pub source: PathBuf,
    /// What to do.
    #[arg(long)]
    pub action: String,
    /// How long to do it.
    #[arg(long)]
    pub seconds: f64,
    /// Seed of the first motion; the others count up from it.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Number of motions.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub count: u64,
    /// Poses per second; otherwise as many as the clips have. Decoded at these times, not interpolated.
    #[arg(long = "fps", value_name = "RATE")]
    pub rate_hz: Option<f64>,
    /// Take the nearest trained length when the one asked for was never trained.
    #[arg(long)]
    pub clamp: bool,
    /// How codes are drawn.
    #[command(flatten)]
    pub sampler: RunSamplerArgs,
}

impl MotionArgs {
    /// Generates all of them, in the order of their seeds.
    ///
    /// # Errors
    /// An action or a length that the model does not know; a length or rate that no motion can have; a run or blob
    /// that cannot be read.
    pub fn generate(&self) -> Result<Vec<Motion>> {
        self.check()?;
        let requests = (0..self.count).map(|index| Request {
            action: self.action.clone(),
            seconds: self.seconds,
            seed: self.seed.wrapping_add(index),
            clamp: self.clamp,
            rate_hz: self.rate_hz,
        });
        if self.source.is_dir() {
            let checkpoint = Checkpoint::load(&self.source)?;
            let mixtures = mixture::file::of_checkpoint(&self.source, &checkpoint)?;
            let stored = self.sampler.build(&checkpoint, &mixtures)?;
            let sampler: &dyn CodeSampler = match &stored {
                Some(stored) => &**stored,
                None => &mixtures,
            };
            return requests
                .map(|request| generate_float(&checkpoint, &mixtures, sampler, &request))
                .collect();
        }
        self.sampler.check_none(&self.source)?;
        let blob = read_blob(&self.source)?;
        let model = load(&self.source, &blob)?;
        let crc = karakuri::blob::stored_crc(&blob).unwrap_or_default();
        let named = |motion: Motion| Motion {
            provenance: format!("{}, blob CRC-32 {crc:08x}", motion.provenance),
            ..motion
        };
        requests.map(|request| generate_blob(&self.source, &model, &request).map(named)).collect()
    }

    fn check(&self) -> Result<()> {
        if !(self.seconds.is_finite() && self.seconds > 0.0) {
            return Err(Error::bad_input(
                "--seconds",
                "the length",
                self.seconds,
                "a positive number",
                "give the length in seconds, such as 2.4",
            ));
        }
        self.rate_hz.map_or(Ok(()), |rate_hz| check_rate("--fps".as_ref(), rate_hz))
    }
}
