//! `host-trainer inspect PATH`: explains clips, or a blob.

use std::path::PathBuf;

use crate::inspect_blob::read_blob;
use crate::commands::inspect_clips::{self, ImportArgs};
use crate::error::Result;
use crate::inspect_blob::BlobReport;

/// Arguments of `inspect`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  host-trainer inspect clips --fps 50\n  host-trainer inspect creature.kara")]
pub struct InspectArgs {
    /// A folder of clips, a clip, or a blob (`.kara`).
    pub path: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// How clips are read.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// Prints a report on stdout.
pub fn run(args: &InspectArgs) -> Result<()> {
    if args.path.extension().is_none_or(|extension| extension != "kara") {
        return inspect_clips::run(&args.path, &args.import, args.json);
    }
    let blob = read_blob(&args.path)?;
    let report = BlobReport::new(&args.path, &blob)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report).unwrap_or_default());
    } else {
        print!("{report}");
    }
    Ok(())
}
