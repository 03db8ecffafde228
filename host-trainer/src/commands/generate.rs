//! `host-trainer generate`: new motions as files and pictures.

use std::path::PathBuf;

use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::Checkpoint;
use crate::commands::sampler_args::RunSamplerArgs;
use crate::error::{Error, Result};
use crate::evaluate::source::CodeSampler;
use crate::export::{self, ExportFormat, Motion};
use crate::generate::{Request, generate_blob, generate_float};
use crate::inspect::blob::{load, read_blob};
use crate::mixture;
use crate::picture;
use crate::stdout::print;

/// Arguments of `generate`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer generate creature.kara --action nod --seconds 2.4 --seed 7 \
    --count 3 --out motions --as csv --plot"
)]
pub struct GenerateArgs {
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
    /// Folder for the files.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// File format.
    #[arg(long = "as", value_enum, default_value_t = ExportFormat::Csv)]
    pub format: ExportFormat,
    /// Also draw a contact sheet.
    #[arg(long)]
    pub plot: bool,
    /// Take the nearest trained length when the one asked for was never trained.
    #[arg(long)]
    pub clamp: bool,
    /// How codes are drawn.
    #[command(flatten)]
    pub sampler: RunSamplerArgs,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// Writes the motions and prints the files' names on stdout, one a line.
pub fn run(args: &GenerateArgs) -> Result<()> {
    if !(args.seconds.is_finite() && args.seconds > 0.0) {
        return Err(Error::bad_input(
            "--seconds",
            "the length",
            args.seconds,
            "a positive number",
            "give the length in seconds, such as 2.4",
        ));
    }
    let motions = generate_all(args)?;
    let mut files = Vec::new();
    for motion in &motions {
        let name = format!(
            "{}_{:.2}s_seed{}.{}",
            motion.action,
            motion.seconds,
            motion.seed,
            args.format.extension()
        );
        files.extend(export::encode(motion, args.format, &args.out.join(name))?);
    }
    if args.plot {
        let path = args.out.join(format!("{}_seed{}.svg", args.action, args.seed));
        let title = format!("{}, {} s, from {}", args.action, args.seconds, args.source.display());
        files.push((path, picture::contact_sheet(&motions, &title)?.into_bytes()));
    }
    let overwrite = Overwrite::from_force(args.force);
    // Before the folder is made: a refusal leaves nothing behind.
    files.iter().try_for_each(|(file, _)| atomic_file::check(file, overwrite))?;
    std::fs::create_dir_all(&args.out).map_err(Error::io("create", &args.out))?;
    export::write_files(&files, overwrite)?;
    let names: String = files.iter().map(|(file, _)| format!("{}\n", file.display())).collect();
    print(names)
}

fn generate_all(args: &GenerateArgs) -> Result<Vec<Motion>> {
    let requests = (0..args.count).map(|index| Request {
        action: args.action.clone(),
        seconds: args.seconds,
        seed: args.seed.wrapping_add(index),
        clamp: args.clamp,
    });
    if args.source.is_dir() {
        let checkpoint = Checkpoint::load(&args.source)?;
        let mixtures = mixture::file::of_checkpoint(&args.source, &checkpoint)?;
        let stored = args.sampler.build(&checkpoint, &mixtures)?;
        let sampler: &dyn CodeSampler = match &stored {
            Some(stored) => &**stored,
            None => &mixtures,
        };
        return requests
            .map(|request| generate_float(&checkpoint, &mixtures, sampler, &request))
            .collect();
    }
    args.sampler.check_none(&args.source)?;
    let blob = read_blob(&args.source)?;
    let model = load(&args.source, &blob)?;
    requests.map(|request| generate_blob(&args.source, &model, &request)).collect()
}
