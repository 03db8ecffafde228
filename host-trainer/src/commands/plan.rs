//! `host-trainer plan`: does the model fit, how fast is it, would keyframes be smaller?

use std::path::{Path, PathBuf};

use karakuri::{ActionId, Model};

use crate::checkpoint::Checkpoint;
use crate::commands::clips::read_clip_set;
use crate::commands::inspect_clips::ImportArgs;
use crate::commands::quantize::{FormatArg, quantize_checkpoint};
use crate::error::Result;
use crate::generate::{Request, generate_blob};
use crate::inspect::blob::{load, read_blob};
use crate::mixture;
use crate::plan::Plan;
use crate::plan::board::Board;
use crate::plan::hinges::Hinges;
use crate::plan::keyframe_bytes::KeyframeReport;
use crate::quantize::QuantizeOptions;
use crate::stdout::{print, print_json};

/// Motions of every action that stand in for clips.
const MOTIONS_PER_ACTION: u64 = 4;

/// Arguments of `plan`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer plan creature.kara --data clips --board rp2040 --board stm32f4"
)]
pub struct PlanArgs {
    /// Folder of a run, or a blob.
    #[arg(value_name = "RUN|FILE.kara")]
    pub source: PathBuf,
    /// Board to plan for; may be given several times.
    #[arg(long = "board", value_enum, value_name = "BOARD",
        default_values_t = [Board::Rp2040, Board::Rp2350, Board::Stm32f4])]
    pub boards: Vec<Board>,
    /// Clips to compare with as keyframes; without them, new motions of the model.
    #[arg(long, value_name = "CLIPS")]
    pub data: Option<PathBuf>,
    /// Number format in which a run would become a blob.
    #[arg(long, value_enum, default_value_t = FormatArg::W8a16)]
    pub number_format: FormatArg,
    /// Print JSON instead of tables.
    #[arg(long)]
    pub json: bool,
    /// What the clips do not say themselves.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// Prints the plan on stdout.
///
/// # Errors
/// A run, blob or clip that cannot be read.
pub fn run(args: &PlanArgs) -> Result<()> {
    let blob = match args.source.is_dir() {
        true => quantized(&args.source, args.number_format)?,
        false => read_blob(&args.source)?,
    };
    let model = load(&args.source, &blob)?;
    let keyframes = match &args.data {
        Some(path) => of_clips(path, &args.import)?,
        None => of_motions(&args.source, &model)?,
    };
    let plan = Plan::new(&model, blob.len(), &args.boards, keyframes);
    if args.json { print_json(&plan) } else { print(format_args!("{plan}\n")) }
}

fn quantized(run: &Path, format: FormatArg) -> Result<Vec<u8>> {
    let checkpoint = Checkpoint::load(run)?;
    let mixtures = mixture::file::of_checkpoint(run, &checkpoint)?;
    let name = run.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let options = QuantizeOptions::new(format.into());
    Ok(quantize_checkpoint(&name, &checkpoint, &mixtures, &options)?.blob)
}

fn of_clips(path: &Path, import: &ImportArgs) -> Result<KeyframeReport> {
    let (set, _) = read_clip_set(path, import)?;
    let hinges: Vec<Hinges> =
        set.clips.iter().map(|clip| Hinges::new(&set.layout, &clip.poses)).collect();
    Ok(KeyframeReport::new(path.display().to_string(), &hinges, set.rate_hz))
}

/// In the middle of every action's lengths.
fn of_motions(path: &Path, model: &Model<'_>) -> Result<KeyframeReport> {
    let rate_hz = f64::from(model.rate_millihz()) / 1000.0;
    let mut hinges = Vec::new();
    for (index, action) in (0..).zip(model.actions()) {
        let frames = model.trained_frames(ActionId(index));
        let frames = frames.start().midpoint(*frames.end());
        for seed in 0..MOTIONS_PER_ACTION {
            let request = Request {
                action: action.to_owned(),
                seconds: f64::from(frames) / rate_hz,
                seed,
                clamp: true,
                rate_hz: None,
            };
            let motion = generate_blob(path, model, &request)?;
            hinges.push(Hinges::new(&motion.layout, &motion.poses));
        }
    }
    let source = "new motions of the model, for lack of --data".to_owned();
    Ok(KeyframeReport::new(source, &hinges, rate_hz))
}
