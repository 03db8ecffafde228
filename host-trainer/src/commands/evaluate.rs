//! `host-trainer evaluate`: the papers' figures of a run or a blob, beside those of real clips.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::{Checkpoint, dataset_hash, hexadecimal};
use crate::classifier::Classifier;
use crate::clip::ClipSet;
use crate::commands::clips::{read_clip_set, split};
use crate::commands::inspect_clips::ImportArgs;
use crate::commands::sampler_args::RunSamplerArgs;
use crate::error::{Error, Result};
use crate::evaluate::evaluate;
use crate::evaluate::judge::Judge;
use crate::evaluate::picture::draw;
use crate::evaluate::protocol::{ActionShares, Protocol, Start};
use crate::evaluate::real::RealMotions;
use crate::evaluate::report::{ClassifierDescription, Evaluation};
use crate::evaluate::source::{BlobSource, ClipCodes, CodeSampler, FloatSource, MotionSource};

use crate::hold_out::hold_out;
use crate::inspect::blob::{load, read_blob};
use crate::mixture;
use crate::stdout::{print, print_json};
use crate::train::Progress;

/// Arguments of `evaluate`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer evaluate creature.kara --run runs/creature --data clips \
    --classifier classifier.safetensors --json"
)]
pub struct EvaluateArgs {
    /// Folder of a run (float model) or a blob (the device's own arithmetic).
    #[arg(value_name = "RUN|FILE.kara")]
    pub source: PathBuf,
    /// The clips that it was made of, held-out ones too.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Weights of the action classifier, safetensors.
    #[arg(long, value_name = "FILE")]
    pub classifier: PathBuf,
    /// The run that a blob was made of: its configuration says which clips were held out.
    #[arg(long, value_name = "RUN")]
    pub run: Option<PathBuf>,
    /// Repetitions, each with fresh draws.
    #[arg(long, default_value_t = 20, value_parser = at_least_one())]
    pub repetitions: usize,
    /// Seed of all draws.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// The classifier's hidden state before frame 0.
    #[arg(long, value_enum, default_value_t = Start::Zeros)]
    pub start: Start,
    /// One motion a clip, or equally many of every action (ODMO).
    #[arg(long, value_enum, default_value_t = Shares::Data)]
    pub actions: Shares,
    /// Motions of every action, for `--actions uniform`.
    #[arg(long, value_name = "COUNT", default_value_t = 250, value_parser = at_least_one())]
    pub motions_per_action: usize,
    /// Poses that the classifier sees.
    #[arg(long, default_value_t = 60, value_parser = at_least_one())]
    pub frames: usize,
    /// Column of labels.csv with the classifier's number of each action, where its file has no names.
    #[arg(long, value_name = "COLUMN")]
    pub action_order_column: Option<String>,
    /// Of a run: decode the clips' own codes instead of new ones, which shows what the decoder alone loses.
    #[arg(long, conflicts_with = "sampler")]
    pub replay: bool,
    /// Also write the figures, as JSON and as a picture, into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// How codes are drawn.
    #[command(flatten)]
    pub sampler: RunSamplerArgs,
    /// How the clips are read.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// How often each action is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Shares {
    /// As the clips
    Data,
    /// Equally often
    Uniform,
}

fn at_least_one() -> clap::builder::RangedU64ValueParser<usize> {
    clap::builder::RangedU64ValueParser::new().range(1..=1_000_000)
}

impl EvaluateArgs {
    /// What the flags say of the measurement.
    pub fn protocol(&self) -> Protocol {
        Protocol {
            repetitions: self.repetitions,
            seed: self.seed,
            start: self.start,
            actions: match self.actions {
                Shares::Data => ActionShares::Data,
                Shares::Uniform => {
                    ActionShares::Uniform { motions_per_action: self.motions_per_action }
                }
            },
            frames: self.frames,
        }
    }
}

/// Prints the figures.
///
/// # Errors
/// Those of reading run, blob, clips and classifier; whatever of them does not fit the others.
pub fn run(args: &EvaluateArgs) -> Result<()> {
    let overwrite = Overwrite::from_force(args.force);
    // Before minutes of work.
    let files = args
        .out
        .as_ref()
        .map(|out| ["evaluation.svg", "evaluation.json"].map(|name| out.join(name)));
    files.iter().flatten().try_for_each(|file| atomic_file::check(file, overwrite))?;
    let evaluation = measure(args)?;
    if let Some(([picture, json], out)) = files.as_ref().zip(args.out.as_ref()) {
        fs::create_dir_all(out).map_err(Error::io("create", out))?;
        atomic_file::write(picture, draw(&evaluation).as_bytes(), overwrite)?;
        let text = serde_json::to_string_pretty(&evaluation).map_err(std::io::Error::from);
        let text = text.map_err(Error::io("write", json))? + "\n";
        atomic_file::write(json, text.as_bytes(), overwrite)?;
    }
    if args.json { print_json(&evaluation) } else { print(&evaluation) }
}

fn measure(args: &EvaluateArgs) -> Result<Evaluation> {
    let classifier = Classifier::load(&args.classifier)?;
    if args.source.is_dir() {
        let checkpoint = Checkpoint::load(&args.source)?;
        let data = read_data(args, Some((&args.source, &checkpoint)))?;
        let (name, hash) = (
            args.source.display().to_string(),
            file_hash(&args.source.join(Checkpoint::FILE_NAME))?,
        );
        if args.replay {
            let codes = ClipCodes(&checkpoint);
            let source = FloatSource::new(&checkpoint, &codes, name, hash)?;
            return measure_source(args, &source, &data, &classifier);
        }
        let mixtures = mixture::file::of_checkpoint(&args.source, &checkpoint)?;
        let stored = args.sampler.build(&checkpoint, &mixtures)?;
        let sampler: &dyn CodeSampler = match &stored {
            Some(stored) => &**stored,
            None => &mixtures,
        };
        let source = FloatSource::new(&checkpoint, sampler, name, hash)?;
        return measure_source(args, &source, &data, &classifier);
    }
    args.sampler.check_none(&args.source)?;
    if args.replay {
        let remedy = "name the run's folder, or leave --replay out";
        return Err(Error::bad_input(&args.source, "--replay", "of a blob", "a run", remedy));
    }
    let blob = read_blob(&args.source)?;
    let model = load(&args.source, &blob)?;
    let source = BlobSource::new(&args.source, &model, &blob)?;
    let checkpoint = args.run.as_deref().map(Checkpoint::load).transpose()?;
    let run = args.run.as_deref().zip(checkpoint.as_ref());
    if let Some((run, checkpoint)) = run {
        check_same_run(args, run, checkpoint, &source.description().config_hash)?;
    }
    let data = read_data(args, run)?;
    measure_source(args, &source, &data, &classifier)
}

fn measure_source(
    args: &EvaluateArgs,
    source: &dyn MotionSource,
    data: &RealMotions,
    classifier: &Classifier,
) -> Result<Evaluation> {
    let description = ClassifierDescription {
        file: args.classifier.display().to_string(),
        sha256: file_hash(&args.classifier)?,
    };
    let order = args.action_order_column.as_deref();
    let order = order.map(|column| read_order(&args.data, &args.import, column)).transpose()?;
    let judge = Judge::new(classifier, description, data, order.as_deref())?;
    evaluate(source, data, &judge, &args.protocol(), Progress::Bar)
}

/// The clips, split as for the run's training; all on one side without a run.
///
/// # Errors
/// Those of reading clips; a dataset that is not the run's.
pub fn read_data(args: &EvaluateArgs, run: Option<(&Path, &Checkpoint)>) -> Result<RealMotions> {
    let (clip_set, skeleton) = read_clip_set(&args.data, &args.import)?;
    let mut clip_set_on_skeleton = clip_set.clone();
    if skeleton.is_some() {
        clip_set_on_skeleton.skeleton.clone_from(&skeleton);
    }
    let Some((run, checkpoint)) = run else {
        return RealMotions::new(&clip_set_on_skeleton, None);
    };
    let config = &checkpoint.config;
    let data = split(clip_set, skeleton, config)?;
    if dataset_hash(&data.training.dataset) != checkpoint.state.dataset_hash {
        return Err(Error::bad_input(
            &args.data,
            "the dataset",
            "another one than the run's",
            format!("the clips that {} was trained on, read by the same flags", run.display()),
            "give the same folder and flags as to train",
        ));
    }
    let (training, held_out) = hold_out(clip_set_on_skeleton, config.hold_out, config.seed)?;
    RealMotions::new(&training, held_out.as_ref())
}

fn check_same_run(
    args: &EvaluateArgs,
    run: &Path,
    checkpoint: &Checkpoint,
    hash: &str,
) -> Result<()> {
    if checkpoint.state.config_hash == hash {
        return Ok(());
    }
    Err(Error::bad_input(
        &args.source,
        "configuration",
        hash,
        format!("{}, as {}", checkpoint.state.config_hash, run.display()),
        "give the run that the blob was made of",
    ))
}

/// Names of the actions in the order of their numbers in another column of the labels.
///
/// # Errors
/// Those of reading the clips; a column that does not number the actions from 0.
pub fn read_order(data: &Path, import: &ImportArgs, column: &str) -> Result<Vec<String>> {
    let (names, _) = read_clip_set(data, import)?;
    let by_number = ImportArgs {
        label_action_column: Some(column.to_owned()),
        label_groups: None,
        ..import.clone()
    };
    let (numbers, _) = read_clip_set(data, &by_number)?;
    order_of(&names, &numbers, column)
}

fn order_of(names: &ClipSet, numbers: &ClipSet, column: &str) -> Result<Vec<String>> {
    let refused = |clip: &str, value: String, expected: String| {
        let remedy = "name another --action-order-column";
        Err(Error::bad_input(clip, format!("column {column}"), value, expected, remedy))
    };
    let mut order: BTreeMap<usize, &str> = BTreeMap::new();
    for (name, number) in names.clips.iter().zip(&numbers.clips) {
        let Ok(index) = number.action.parse::<usize>() else {
            return refused(&name.name, number.action.clone(), "a number from 0".to_owned());
        };
        let known = *order.entry(index).or_insert(&name.action);
        if known != name.action {
            let value = format!("{index} for {}", name.action);
            return refused(&name.name, value, format!("one action a number; {index} is {known}"));
        }
    }
    if order.keys().copied().ne(0..order.len()) {
        let found: Vec<String> = order.keys().map(usize::to_string).collect();
        return refused("labels", found.join(", "), format!("0 to {}", order.len() - 1));
    }
    Ok(order.into_values().map(str::to_owned).collect())
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// A file that cannot be read.
pub fn file_hash(file: &Path) -> Result<String> {
    let bytes = fs::read(file).map_err(Error::io("read", file))?;
    Ok(hexadecimal(&Sha256::digest(bytes)))
}

#[cfg(test)]
mod tests;
