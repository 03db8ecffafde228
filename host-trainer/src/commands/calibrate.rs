//! `host-trainer calibrate`: the servos of a robot into a blob, or a file to start measuring with.

use std::path::{Path, PathBuf};

use crate::atomic_file::{self, Overwrite};
use crate::calibration::Calibration;
use crate::calibration::template::template;
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::generate::layout_of;
use crate::inspect::blob::{load, read_blob};
use crate::layout::PoseLayout;
use crate::stdout::print;

/// Arguments of `calibrate`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  host-trainer calibrate creature.kara --template --out robot.toml\n  \
    host-trainer calibrate creature.kara --calibration robot.toml --out mine.kara"
)]
pub struct CalibrateArgs {
    /// Blob; with --template also the folder of a run.
    pub model: PathBuf,
    /// Calibration of the robot's servos.
    #[arg(long, value_name = "FILE.toml", required_unless_present = "template")]
    pub calibration: Option<PathBuf>,
    /// Write a calibration to start from, with every servo that the model can drive.
    #[arg(long, conflicts_with = "calibration")]
    pub template: bool,
    /// The blob with the servos, or the template.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
}

/// Writes the calibrated blob and prints its servos on stdout; or writes the template.
pub fn run(args: &CalibrateArgs) -> Result<()> {
    let overwrite = Overwrite::from_force(args.force);
    atomic_file::check(&args.out, overwrite)?;
    match &args.calibration {
        Some(file) => {
            let blob = Calibration::read(file)?.put_into(&args.model, &read_blob(&args.model)?)?;
            atomic_file::write(&args.out, &blob, overwrite)?;
            let count = load(&args.out, &blob)?.servos().count();
            print(format_args!("{count} servos, {} bytes\n", blob.len()))?;
        }
        None => {
            let text = template(&layout(&args.model)?);
            atomic_file::write(&args.out, text.as_bytes(), overwrite)?;
        }
    }
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

fn layout(model: &Path) -> Result<PoseLayout> {
    if model.is_dir() {
        return Ok(Checkpoint::load(model)?.dataset.layout);
    }
    Ok(layout_of(&load(model, &read_blob(model)?)?))
}
