//! `host-trainer tune RUN --out RUN2`: a trained run → one whose blob loses less to its number format.

use std::fs;
use std::path::PathBuf;

use karakuri::NumberFormat;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::atomic_file;
use crate::checkpoint::{Checkpoint, hexadecimal};
use crate::commands::quantize::{input_of, parse_size, progress_bar};
use crate::commands::train::{resume_command, stop_on_interrupt};
use crate::error::{Error, Result};
use crate::mixture;
use crate::quantize::flash_budget::quantize_within;
use crate::quantize::{QuantizeInput, QuantizeOptions, activation_scales, observe_activations};
use crate::stdout::{print, print_json};
use crate::table::Table;
use crate::train::{Progress, Start};
use crate::tune::{TuneOptions, TuneRequest, Tuned, tune};

/// What the user types after `tune`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer tune runs/creature --format w8a8 --out runs/creature-w8a8\n  \
    host-trainer quantize runs/creature-w8a8 --format w8a8 --out creature.kara"
)]
pub struct TuneArgs {
    /// Folder of the trained run; it stays as it is
    pub run: PathBuf,
    /// Number format that the result will be quantised to
    #[arg(long, value_enum, required_unless_present = "flash")]
    pub format: Option<TuneFormat>,
    /// Tune for the weights that `quantize --flash SIZE` picks for RUN, 4 or 8 bits a layer (w4a8). Quantise the result
    /// with `--format w4a8`
    #[arg(long, value_name = "SIZE", value_parser = parse_size, conflicts_with = "format")]
    pub flash: Option<usize>,
    /// Folder of the tuned run: checkpoint, metrics, plot
    #[arg(long, value_name = "RUN2")]
    pub out: PathBuf,
    /// Steps
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: u64,
    /// Learning rate of the first step, which falls to 0 along a cosine; otherwise 1e-4 for w8a16, 3e-4 for w8a8 and
    /// 1e-3 for w4a8
    #[arg(long, value_name = "RATE", value_parser = positive)]
    pub learning_rate: Option<f64>,
    /// Seed of codes and frames that are drawn
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Go on from the checkpoint in RUN2
    #[arg(long)]
    pub resume: bool,
    /// Threads; otherwise one per core
    #[arg(long, value_name = "COUNT")]
    pub threads: Option<usize>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Formats that rounding costs something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TuneFormat {
    /// i8 weights, i16 activations.
    W8a16,
    /// i8 weights, i8 activations.
    W8a8,
    /// 4-bit weights, i8 activations.
    W4a8,
}

impl From<TuneFormat> for NumberFormat {
    fn from(format: TuneFormat) -> Self {
        match format {
            TuneFormat::W8a16 => Self::W8A16,
            TuneFormat::W8a8 => Self::W8A8,
            TuneFormat::W4a8 => Self::W4A8,
        }
    }
}

impl TuneFormat {
    /// Coarser steps take larger moves; the best of four rates a decade apart by halves on Chako.
    fn learning_rate(self) -> f64 {
        match self {
            Self::W8a16 => 1e-4,
            Self::W8a8 => 3e-4,
            Self::W4a8 => 1e-3,
        }
    }
}

/// What `--json` prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report<'a> {
    run: String,
    out: String,
    format: &'static str,
    steps: u64,
    seed: u64,
    parent_hash: &'a str,
    errors: Vec<ErrorPair>,
}

/// Root mean square error against the float model, for clips' mean codes.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ErrorPair {
    /// Kind and unit: `translation_mm`.
    of: String,
    /// At step 0.
    before: f64,
    /// At the end.
    after: f64,
}

/// Tunes, then prints what it gained.
///
/// # Errors
/// Those of reading the run and of [`tune`]; [`Error::Interrupted`] after Ctrl-C.
pub fn run(args: &TuneArgs) -> Result<()> {
    let parent = load_parent(args)?;
    let file = args.run.join(Checkpoint::FILE_NAME);
    let bytes = fs::read(&file).map_err(Error::io("read", &file))?;
    let parent_hash = hexadecimal(&Sha256::digest(bytes));
    let tune_format = args.format.unwrap_or(TuneFormat::W4a8);
    let format = tune_format.into();
    let mixtures = mixture::file::of_checkpoint(&args.run, &parent)?;
    let input = input_of("tune", &parent, &mixtures, None);
    let request = TuneRequest {
        activations: activation_scales(&observe_activations(&input)?, format),
        weight_bits: args.flash.map_or(Ok(Vec::new()), |size| weight_bits(&input, size))?,
        parent: &parent,
        parent_hash: &parent_hash,
        format,
        step_count: args.steps,
        learning_rate: args.learning_rate.unwrap_or(tune_format.learning_rate()),
        seed: args.seed,
    };
    let stop = stop_on_interrupt(&args.out)?;
    let options = TuneOptions {
        start: if args.resume { Start::Resume } else { Start::New },
        stop: &stop,
        resume_command: &resume_command(std::env::args()),
        progress: Progress::Bar,
    };
    let mut threads = rayon::ThreadPoolBuilder::new();
    if let Some(thread_count) = args.threads {
        threads = threads.num_threads(thread_count);
    }
    let no_threads =
        |error| Error::io("start threads for", &args.out)(std::io::Error::other(error));
    let pool = threads.build().map_err(no_threads)?;
    let tuned = pool.install(|| tune(&request, &args.out, &options))?;
    copy_mixtures(args)?;
    report(args, &parent_hash, &tuned)
}

/// Codes have not moved, so the mixtures fitted to them still hold.
fn copy_mixtures(args: &TuneArgs) -> Result<()> {
    let source = args.run.join(mixture::file::FILE_NAME);
    let bytes = fs::read(&source).map_err(Error::io("read", &source))?;
    atomic_file::replace(&args.out.join(mixture::file::FILE_NAME), |file| {
        std::io::Write::write_all(file, &bytes)
    })
}

/// The run, unless it was tuned itself: its float model is no target any more.
fn load_parent(args: &TuneArgs) -> Result<Checkpoint> {
    let parent = Checkpoint::load(&args.run)?;
    match &parent.state.tuning {
        None => Ok(parent),
        Some(tuning) => {
            let remedy = "give the run that it was tuned from";
            let value = format!("tuned for {}", tuning.format);
            Err(Error::bad_input(&args.run, "RUN", value, "a run of `host-trainer train`", remedy))
        }
    }
}

/// The bits that `quantize --flash` picks for the parent; its curve goes to stderr.
fn weight_bits(input: &QuantizeInput<'_>, bytes_max: usize) -> Result<Vec<u8>> {
    let options = QuantizeOptions::new(NumberFormat::W4A8);
    let (_, budget) = quantize_within(input, &options, bytes_max, &progress_bar())?;
    eprintln!("{budget}");
    Ok(budget.weight_bits().to_vec())
}

fn report(args: &TuneArgs, parent_hash: &str, tuned: &Tuned) -> Result<()> {
    let pairs = tuned.before.error_rms.iter().zip(tuned.after.error_rms.values());
    let errors: Vec<ErrorPair> =
        pairs.map(|((of, &before), &after)| ErrorPair { of: of.clone(), before, after }).collect();
    if args.json {
        return print_json(&Report {
            run: args.run.display().to_string(),
            out: args.out.display().to_string(),
            format: NumberFormat::from(args.format.unwrap_or(TuneFormat::W4a8)).name(),
            steps: args.steps,
            seed: args.seed,
            parent_hash,
            errors,
        });
    }
    let mut table = Table::new(["off the float model, RMS", "before", "after"]);
    for error in errors {
        table.push([error.of, format!("{:.4}", error.before), format!("{:.4}", error.after)]);
    }
    print(table)?;
    eprintln!("{} steps, in {}", args.steps, args.out.display());
    Ok(())
}

fn positive(text: &str) -> core::result::Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err("expected more than 0".to_owned())
    }
}
