//! `host-trainer reproduce`: the papers' experiments → one report.

use std::path::{Path, PathBuf};

use crate::atomic_file::Overwrite;
use crate::classifier::train::Settings;
use crate::commands::classify::learn;
use crate::commands::evaluate::read_order;
use crate::commands::train::stop_on_interrupt;
use crate::error::{Error, Result};
use crate::reproduce::cache::Key;
use crate::reproduce::clips::Clips;
use crate::reproduce::estimate::{TrainingEstimate, estimate};
use crate::reproduce::experiments::Experiments;
use crate::reproduce::measure::Measure;
use crate::reproduce::plan::{Budget, plan};
use crate::reproduce::stages::Workshop;
use crate::reproduce::{Reproduction, cache, report, reproduce};
use crate::stdout::{print, print_json};
use crate::train::Progress;

/// Arguments of `reproduce`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  host-trainer reproduce humanact12 --data humanact12 \\\n    \
    --classifier humanact12.safetensors --out runs/humanact12 --passes 300 --only paper,small\n\n\
    Kill it at any time: the same command goes on where it was. \
    What is in --out already is not done again.")]
pub struct ReproduceArgs {
    /// Built-in experiments: humanact12 or cmu
    #[arg(required_unless_present = "experiments")]
    pub dataset: Option<String>,
    /// Folder of clips and labels
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// The classifier that measures generated motions. Without one, cmu trains its own; humanact12 then measures
    /// only how clips are given back
    #[arg(long, value_name = "FILE")]
    pub classifier: Option<PathBuf>,
    /// Folder of everything that is made; one that exists is gone on with
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// TOML file of experiments in place of the built-in ones
    #[arg(long, value_name = "FILE", conflicts_with = "dataset")]
    pub experiments: Option<PathBuf>,
    /// Do these rows only
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Steps of every training; otherwise as each preset says, which takes hours
    #[arg(long, conflicts_with = "passes",
          value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: Option<u64>,
    /// Passes over the clips of every training: the same number of poses whatever the size of a batch
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub passes: Option<u64>,
    /// Repetitions of every measurement, each with fresh draws
    #[arg(long, value_name = "COUNT", default_value_t = 20,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1000))]
    pub repetitions: usize,
    /// Threads; otherwise one per core
    #[arg(long, value_name = "COUNT")]
    pub threads: Option<usize>,
    /// Print the records of all rows as JSON
    #[arg(long)]
    pub json: bool,
}

/// Does every stage that is not done yet, and prints the report on stdout.
///
/// # Errors
/// `BadInput` for bad experiments, an unknown row, missing data, and at the end when rows failed; `Interrupted` after
/// Ctrl-C; `Io` when something cannot be read or written.
pub fn run(args: &ReproduceArgs) -> Result<()> {
    let (experiments, source) = match (&args.experiments, &args.dataset) {
        (Some(file), _) => (Experiments::read(file)?, file.clone()),
        (None, dataset) => {
            let dataset = dataset.as_deref().unwrap_or_default();
            (Experiments::built_in(dataset)?, PathBuf::from(dataset))
        }
    };
    let budget = match (args.steps, args.passes) {
        (Some(steps), _) => Budget::Steps(steps),
        (None, Some(passes)) => Budget::Passes(passes),
        (None, None) => Budget::Preset,
    };
    let rows = plan(&experiments, &args.only, budget, &source)?;
    let mut clips = Clips::open(&args.data, experiments.import_args())?;
    cache::folder(&args.out)?;
    let stop = stop_on_interrupt(&args.out)?;
    let resume_command = std::env::args().collect::<Vec<_>>().join(" ");
    let threads = rayon::ThreadPoolBuilder::new().num_threads(args.threads.unwrap_or(0));
    threads
        .build_global()
        .map_err(|error| Error::io("start threads for", &args.out)(std::io::Error::other(error)))?;
    let measure = measure(args, &experiments, &clips)?;
    let workshop = Workshop {
        out: &args.out,
        budget,
        thread_count: args.threads,
        stop: &stop,
        resume_command: &resume_command,
        progress: Progress::Bar,
        measure: measure.as_ref(),
    };
    announce(&estimate(&rows, &mut clips, &workshop)?);
    let reproduction = reproduce(&experiments, &rows, &mut clips, workshop)?;
    show(args, &reproduction)?;
    refuse_failures(&reproduction, &args.out)
}

/// Reads the classifier, or trains one where the experiments say so; says what is missing without one.
fn measure(
    args: &ReproduceArgs,
    experiments: &Experiments,
    clips: &Clips,
) -> Result<Option<Measure>> {
    let import = experiments.import_args();
    if let Some(file) = &args.classifier {
        let column = experiments.action_order_column.as_deref();
        let order = column.map(|column| read_order(&args.data, &import, column)).transpose()?;
        return Measure::open(file, order, experiments, args.repetitions).map(Some);
    }
    let Some(steps) = experiments.classifier_steps else {
        eprintln!("no --classifier: clips given back are measured, generated motions are not");
        return Ok(None);
    };
    let settings = Settings { steps, frames: experiments.frames, ..Settings::default() };
    let key = Key::new("classify").with(&clips.fingerprint).with(settings.hash());
    let file = args.out.join(format!("classifier-{}.safetensors", key.digits()));
    if !file.exists() {
        eprintln!("classifier: train, {steps} steps");
        let learned = learn(&args.data, &import, settings)?;
        learned.classifier.save(&file, Overwrite::Replace)?;
    }
    Measure::open(&file, None, experiments, args.repetitions).map(Some)
}

fn announce(estimate: &TrainingEstimate) {
    match estimate.training_count {
        0 => eprintln!("every training is done already"),
        count => {
            let minutes = estimate.seconds / 60.0;
            eprintln!(
                "{count} trainings to do, {} steps, about {minutes:.0} minutes on this machine as it is now; \
                 mixtures and measurements come on top",
                estimate.steps
            );
        }
    }
}

fn show(args: &ReproduceArgs, reproduction: &Reproduction) -> Result<()> {
    let file = args.out.join(report::FILE_NAME);
    eprintln!("wrote {}", file.display());
    if args.json {
        return print_json(reproduction);
    }
    let text = std::fs::read_to_string(&file).map_err(Error::io("read", &file))?;
    print(text)
}

fn refuse_failures(reproduction: &Reproduction, out: &Path) -> Result<()> {
    let failed = reproduction.failed();
    if failed.is_empty() {
        return Ok(());
    }
    let value =
        format!("{} of {} failed: {}", failed.len(), reproduction.rows.len(), failed.join(", "));
    let remedy = format!("see {}; what is done stays done", out.join(report::FILE_NAME).display());
    Err(Error::bad_input(out, "rows", value, "figures of every row", remedy))
}
