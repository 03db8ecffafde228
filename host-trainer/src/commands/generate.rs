//! `host-trainer generate`: new motions as files and pictures.

use std::path::PathBuf;

use crate::atomic_file::{self, Overwrite};
use crate::commands::motions::MotionArgs;
use crate::error::{Error, Result};
use crate::export::{self, ExportFormat};
use crate::picture;
use crate::stdout::print;

/// Arguments of `generate`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer generate creature.kara --action nod --seconds 2.4 --seed 7 \
    --count 3 --out motions --as csv --plot"
)]
pub struct GenerateArgs {
    /// What to move.
    #[command(flatten)]
    pub motions: MotionArgs,
    /// Folder for the files.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// File format.
    #[arg(long = "as", value_enum, default_value_t = ExportFormat::Csv)]
    pub format: ExportFormat,
    /// Also draw a contact sheet.
    #[arg(long)]
    pub plot: bool,
    /// Replace existing files.
    #[arg(long)]
    pub force: bool,
}

/// Writes the motions and prints the files' names on stdout, one a line.
pub fn run(args: &GenerateArgs) -> Result<()> {
    let motions = args.motions.generate()?;
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
        let MotionArgs { action, seed, seconds, source, .. } = &args.motions;
        let path = args.out.join(format!("{action}_seed{seed}.svg"));
        let title = format!("{action}, {seconds} s, from {}", source.display());
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
