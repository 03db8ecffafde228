//! `host-trainer inspect PATH`: explains clips, or a blob.

use crate::commands::inspect_clips::{self, InspectClipsArgs};
use crate::error::Result;
use crate::inspect::blob::{BlobReport, read_blob};
use crate::stdout::{print, print_json};

/// Prints a report on stdout: of a blob when the path ends in `.kara`, of clips otherwise.
pub fn run(args: &InspectClipsArgs) -> Result<()> {
    if args.path.extension().is_none_or(|extension| extension != "kara") {
        return inspect_clips::run(args);
    }
    let blob = read_blob(&args.path)?;
    let report = BlobReport::new(&args.path, &blob)?;
    if args.json { print_json(&report) } else { print(report) }
}
