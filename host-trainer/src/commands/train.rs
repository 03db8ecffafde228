//! `host-trainer train CLIPS --out RUN`: clips → the folder of a run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::checkpoint::Checkpoint;
use crate::commands::clips::read_clip_data;
use crate::commands::inspect_clips::ImportArgs;
use crate::commands::reconstruct::{Side, error_table};
use crate::config::TrainConfig;
use crate::error::{Error, Result};
use crate::reconstruct::Source;
use crate::represent::Representation;
use crate::stdout::print;
use crate::train::{Progress, Start, TrainOptions, train};

/// What the user types after `train`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer train clips --preset small --out runs/creature --steps 6000"
)]
pub struct TrainArgs {
    /// A clip file, or a folder of clips
    pub clips: PathBuf,
    /// Folder of the run: checkpoint, configuration, metrics, plot
    #[arg(long, value_name = "RUN")]
    pub out: PathBuf,
    /// Built-in settings: paper, published, small or tiny; small if nothing is said
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// TOML file whose keys replace those of the preset
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// How joints are trained: as-is, positions or rotations
    #[arg(long, value_parser = parse_representation)]
    pub representation: Option<Representation>,
    /// Train this many steps; the same clips, settings and seed then give the same bytes
    #[arg(long, conflicts_with = "minutes")]
    pub steps: Option<u64>,
    /// Train this many minutes; the result depends on the machine's speed
    #[arg(long)]
    pub minutes: Option<f64>,
    /// Share of each action's clips that training does not see, for the held-out error: 0.2 is a fifth
    #[arg(long, value_name = "SHARE")]
    pub hold_out: Option<f64>,
    /// Start of every random stream
    #[arg(long)]
    pub seed: Option<u64>,
    /// Go on from the checkpoint in RUN, with its settings
    #[arg(long)]
    pub resume: bool,
    /// Threads; otherwise one per core
    #[arg(long, value_name = "COUNT")]
    pub threads: Option<usize>,
    /// How the clips are read
    #[command(flatten)]
    pub import: ImportArgs,
}

/// Trains, then prints the errors of the result.
///
/// # Errors
/// Those of reading clips, of the configuration and of [`train`]; [`Error::Interrupted`] after Ctrl-C.
pub fn run(args: &TrainArgs) -> Result<()> {
    let config = configure(args)?;
    let data = read_clip_data(&args.clips, &args.import, &config)?;
    let stop = stop_on_interrupt(&args.out)?;
    let options = TrainOptions {
        start: if args.resume { Start::Resume } else { Start::New },
        thread_count: args.threads,
        stop: &stop,
        resume_command: &resume_command(std::env::args()),
        progress: Progress::Bar,
    };
    let checkpoint = train(&data.training.dataset, &config, &args.out, &options)?;
    print(format_args!("{} steps, in {}\n", checkpoint.state.step, args.out.display()))?;
    let sides = Side::of(checkpoint, data);
    let rows: Vec<_> = sides.iter().map(|side| side.row("float", Source::Float, 1)).collect();
    print(error_table(&rows, false))
}

/// The settings: of the checkpoint when resuming without saying any, otherwise preset, file and flags.
fn configure(args: &TrainArgs) -> Result<TrainConfig> {
    let says_none = args.preset.is_none() && args.config.is_none();
    let mut config = if args.resume && says_none {
        Checkpoint::load(&args.out)?.config
    } else {
        let preset = args.preset.as_deref().unwrap_or("small");
        match &args.config {
            Some(file) => TrainConfig::preset_with_file(preset, file)?,
            None => TrainConfig::preset(preset)?,
        }
    };
    if let Some(representation) = args.representation {
        config.representation = representation;
    }
    if let Some(hold_out) = args.hold_out {
        config.hold_out = hold_out;
    }
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    if let Some(steps) = args.steps {
        (config.budget.steps, config.budget.minutes) = (steps, 0.0);
    }
    if let Some(minutes) = args.minutes {
        config.budget.minutes = minutes;
    }
    config.check(Path::new("the command line"))?;
    Ok(config)
}

/// As shells report a program that Ctrl-C ended.
const EXIT_INTERRUPTED: i32 = 130;

/// A flag that Ctrl-C and a polite kill set; a second one ends the program at once, which loses no saved file.
pub(super) fn stop_on_interrupt(run: &Path) -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let on_interrupt = move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(EXIT_INTERRUPTED);
        }
    };
    ctrlc::set_handler(on_interrupt)
        .map_err(|error| Error::io("catch Ctrl-C for", run)(std::io::Error::other(error)))?;
    Ok(stop)
}

/// The command line as typed, with `--resume`.
pub(super) fn resume_command(arguments: impl Iterator<Item = String>) -> String {
    let mut words: Vec<String> = arguments.map(|word| quoted(&word)).collect();
    if !words.iter().any(|word| word == "--resume") {
        words.push("--resume".to_owned());
    }
    words.join(" ")
}

/// A word as a shell reads it back.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+@%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

fn parse_representation(text: &str) -> core::result::Result<Representation, String> {
    match text {
        "as-is" => Ok(Representation::AsIs),
        "positions" => Ok(Representation::Positions),
        "rotations" => Ok(Representation::Rotations),
        _ => Err("expected as-is, positions or rotations".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resume_command_quotes_and_adds_the_flag_once() {
        let words = ["host-trainer", "train", "my clips", "--out", "it's"].map(String::from);
        let command = resume_command(words.into_iter());
        assert_eq!(command, r"host-trainer train 'my clips' --out 'it'\''s' --resume");
        let again = resume_command(["t", "--resume"].map(String::from).into_iter());
        assert_eq!(again, "t --resume");
    }
}
