//! `host-trainer classify CLIPS --out FILE`: clips → the classifier that `evaluate` measures with.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::atomic_file::{self, Overwrite};
use crate::body::skeleton::Skeleton;
use crate::classifier::example::Examples;
use crate::classifier::train::{Settings, Trained, train};
use crate::classifier::{Classifier, Description};
use crate::commands::inspect_clips::ImportArgs;
use crate::error::{Error, Result};
use crate::hold_out::hold_out;
use crate::import;
use crate::stdout::{print, print_json};
use crate::table::Table;

/// What the user types after `classify`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer classify clips --out judge.safetensors\n\nIt learns in minutes and writes \
    nothing before it is done. The last weights are kept: the held-out clips choose nothing."
)]
pub struct ClassifyArgs {
    /// A clip file, or a folder of clips
    pub clips: PathBuf,
    /// File of the classifier (.safetensors)
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Poses that it sees of a motion; of longer ones a window, shorter ones wait in their last pose
    #[arg(long, default_value_t = Settings::default().frames, value_parser = at_least_1)]
    pub frames: usize,
    /// Steps of the optimiser
    #[arg(long, default_value_t = Settings::default().steps, value_parser = at_least_1)]
    pub steps: usize,
    /// Share of each action's clips that it does not learn from, for the held-out accuracy; 0 for none
    #[arg(long, value_name = "SHARE", default_value_t = Settings::default().hold_out)]
    pub hold_out: f64,
    /// Start of every random stream
    #[arg(long, default_value_t = Settings::default().seed)]
    pub seed: u64,
    /// Threads; otherwise one per core
    #[arg(long, value_name = "COUNT")]
    pub threads: Option<usize>,
    /// Replace FILE if it is there
    #[arg(long)]
    pub force: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
    /// How the clips are read
    #[command(flatten)]
    pub import: ImportArgs,
}

/// What `--json` prints.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Report<'a> {
    out: String,
    actions: Vec<ActionReport<'a>>,
    #[serde(flatten)]
    description: &'a Description,
}

/// One action.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ActionReport<'a> {
    action: &'a str,
    training_clip_count: usize,
    held_out_clip_count: usize,
    held_out_accuracy: Option<f64>,
}

/// Trains, writes the file, then prints how often it is right.
///
/// # Errors
/// Those of reading clips, of the split and of [`train`]; an output file that is there already.
pub fn run(args: &ClassifyArgs) -> Result<()> {
    let overwrite = Overwrite::from_force(args.force);
    atomic_file::check(&args.out, overwrite)?;
    let settings = settings(args)?;
    let mut threads = rayon::ThreadPoolBuilder::new();
    if let Some(thread_count) = args.threads {
        threads = threads.num_threads(thread_count);
    }
    let threads = threads.build().map_err(|error| {
        Error::bad_input("--threads", "number", error, "a number of threads", "leave it out")
    })?;
    let learned = threads.install(|| learn(&args.clips, &args.import, settings))?;
    learned.classifier.save(&args.out, overwrite)?;
    let Learned { examples, description, accuracy_by_action, .. } = &learned;
    let report = report(&args.out, examples, description, accuracy_by_action);
    if args.json { print_json(&report) } else { print(text(&report)) }
}

/// A classifier, what it learned from and how it was examined.
pub struct Learned {
    /// Ready to be saved.
    pub classifier: Classifier,
    /// As its file has it.
    pub description: Description,
    examples: Examples,
    accuracy_by_action: Vec<Option<f64>>,
}

/// Reads clips, trains on them and examines.
///
/// # Errors
/// Those of reading clips, of the split and of [`train`].
pub fn learn(clips: &Path, import: &ImportArgs, settings: Settings) -> Result<Learned> {
    let examples = read_examples(clips, import, &settings)?;
    let trained = train(&examples, &settings, &progress_bar(settings.steps))?;
    let description = describe(&examples, settings, &trained);
    Ok(Learned {
        classifier: trained.classifier.with_description(description.clone()),
        description,
        accuracy_by_action: trained.accuracy_by_action,
        examples,
    })
}

fn at_least_1(text: &str) -> core::result::Result<usize, String> {
    text.parse().ok().filter(|count| *count > 0).ok_or_else(|| "expected 1 or more".to_owned())
}

fn settings(args: &ClassifyArgs) -> Result<Settings> {
    if !(0.0..1.0).contains(&args.hold_out) {
        let expected = "at least 0 and below 1";
        let remedy = "0.2 holds out a fifth of the clips";
        return Err(Error::bad_input("--hold-out", "share", args.hold_out, expected, remedy));
    }
    let ClassifyArgs { frames, steps, hold_out, seed, .. } = *args;
    Ok(Settings { frames, steps, hold_out, seed, ..Settings::default() })
}

fn read_examples(clips: &Path, args: &ImportArgs, settings: &Settings) -> Result<Examples> {
    let mut clip_set = import::read(clips, &args.options()?)?;
    if let Some(skeleton) = &args.skeleton {
        clip_set.skeleton = Some(Skeleton::by_name_or_file(skeleton)?);
    }
    let (training, held_out) = hold_out(clip_set, settings.hold_out, settings.seed)?;
    for remark in &training.remarks {
        eprintln!("{remark}");
    }
    Examples::new(&training, held_out.as_ref())
}

fn progress_bar(steps: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:20} step {pos} of {len}, {msg}, {eta} left");
    ProgressBar::new(steps as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn describe(examples: &Examples, settings: Settings, trained: &Trained) -> Description {
    Description {
        input: examples.input,
        names: examples.names.clone(),
        rate_hz: examples.rate_hz,
        config_hash: settings.hash(),
        settings,
        data_hash: examples.data_hash.clone(),
        training_clip_count: examples.training.len(),
        held_out: examples.held_out.iter().map(|example| example.name.clone()).collect(),
        training_accuracy: trained.training_accuracy,
        held_out_accuracy: trained.held_out_accuracy,
    }
}

fn report<'a>(
    out: &Path,
    examples: &'a Examples,
    description: &'a Description,
    accuracy_by_action: &[Option<f64>],
) -> Report<'a> {
    let actions = examples.actions.iter().zip(accuracy_by_action).enumerate();
    let actions = actions.map(|(index, (action, accuracy))| ActionReport {
        action,
        training_clip_count: examples.training.iter().filter(|e| e.action == index).count(),
        held_out_clip_count: examples.held_out.iter().filter(|e| e.action == index).count(),
        held_out_accuracy: *accuracy,
    });
    Report { out: out.display().to_string(), actions: actions.collect(), description }
}

fn text(report: &Report<'_>) -> String {
    let percent = |share: Option<f64>| {
        share.map_or_else(|| "–".to_owned(), |share| format!("{:.1} %", 100.0 * share))
    };
    let mut table = Table::new(["action", "learned from", "held out", "right"]);
    for action in &report.actions {
        table.push([
            action.action.to_owned(),
            action.training_clip_count.to_string(),
            action.held_out_clip_count.to_string(),
            percent(action.held_out_accuracy),
        ]);
    }
    let Description { training_clip_count, held_out, .. } = report.description;
    let right = percent(report.description.held_out_accuracy);
    table.push(["all".into(), training_clip_count.to_string(), held_out.len().to_string(), right]);
    let training = percent(Some(report.description.training_accuracy));
    format!("{table}\n{training} right about the clips that it learned from; in {}\n", report.out)
}
