//! `host-trainer reconstruct`: how well a run, and blobs made of it, give the training clips back.

use std::path::PathBuf;

use serde::Serialize;

use crate::checkpoint::{Checkpoint, dataset_hash};
use crate::commands::clips::read_clip_data;
use crate::commands::inspect_clips::ImportArgs;
use crate::error::{Error, Result};
use crate::inspect::blob::load;
use crate::inspect::blob::read_blob;
use crate::reconstruct::{Reconstruction, Source, reconstruct};
use crate::table::{Table, thousands};

/// Arguments of `reconstruct`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer reconstruct runs/creature clips --blob creature.kara"
)]
pub struct ReconstructArgs {
    /// Folder of the trained run.
    pub run: PathBuf,
    /// The clips that it was trained on.
    pub clips: PathBuf,
    /// Also decode these blobs of the run, in the device's arithmetic.
    #[arg(long, value_name = "FILE.kara")]
    pub blob: Vec<PathBuf>,
    /// Compare every N-th frame.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub stride: usize,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// How the clips are read.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// One decoder's errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// `float`, or the blob's file and format.
    pub decoder: String,
    /// Its errors.
    #[serde(flatten)]
    pub reconstruction: Reconstruction,
}

/// Prints one row for the float model and one a blob.
pub fn run(args: &ReconstructArgs) -> Result<()> {
    let checkpoint = Checkpoint::load(&args.run)?;
    let data = read_clip_data(&args.clips, &args.import, &checkpoint.config)?;
    if dataset_hash(&data.dataset) != checkpoint.state.dataset_hash {
        return Err(Error::bad_input(
            &args.clips,
            "the dataset",
            "another one than the run's",
            format!("the clips that {} was trained on, read by the same flags", args.run.display()),
            "give the same folder and flags as to train",
        ));
    }
    let mut rows = vec![Row {
        decoder: "float".into(),
        reconstruction: reconstruct(
            &checkpoint,
            Source::Float,
            &data.dataset,
            &data.bones,
            args.stride,
        ),
    }];
    for path in &args.blob {
        let blob = read_blob(path)?;
        let model = load(path, &blob)?;
        let source = Source::Blob(&model);
        rows.push(Row {
            decoder: format!("{} ({})", path.display(), model.number_format().name()),
            reconstruction: reconstruct(
                &checkpoint,
                source,
                &data.dataset,
                &data.bones,
                args.stride,
            ),
        });
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&rows).unwrap_or_default());
        return Ok(());
    }
    println!("{} frames", thousands(rows[0].reconstruction.frame_count as u64));
    print!("{}", error_table(&rows));
    Ok(())
}

/// One line per decoder and measure.
pub fn error_table(rows: &[Row]) -> Table {
    let mut table = Table::new(["decoder", "of", "RMS", "mean", "unit"]);
    for row in rows {
        for group in &row.reconstruction.groups {
            let (rms, mean) = (format!("{:.3}", group.rms), format!("{:.3}", group.mean));
            table.push([row.decoder.clone(), group.kind.into(), rms, mean, group.unit.into()]);
        }
        if let Some(joints) = row.reconstruction.joints {
            let measures = [
                ("joints", joints.joint_mm),
                ("root", joints.root_mm),
                ("joints, local", joints.local_mm),
            ];
            for (measure, mean) in measures {
                table.push([
                    row.decoder.clone(),
                    measure.into(),
                    String::new(),
                    format!("{mean:.2}"),
                    "mm".into(),
                ]);
            }
        }
    }
    table
}
