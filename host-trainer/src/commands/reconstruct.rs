//! `host-trainer reconstruct`: how well a run, and blobs made of it, give back the clips of both sides of the split.

use std::path::PathBuf;

use serde::Serialize;

use crate::checkpoint::{Checkpoint, dataset_hash};
use crate::commands::clips::{ClipData, SplitClips, read_clip_data};
use crate::commands::inspect_clips::ImportArgs;
use crate::error::{Error, Result};
use crate::inspect::blob::{load, read_blob};
use crate::reconstruct::{Reconstruction, Source, reconstruct};
use crate::table::{Table, thousands};
use crate::train::Progress;
use crate::train::infer_codes::infer_codes;

/// Arguments of `reconstruct`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer reconstruct runs/creature clips --blob creature.kara"
)]
pub struct ReconstructArgs {
    /// Folder of the trained run.
    pub run: PathBuf,
    /// The clips that it was made of, held-out ones too.
    pub clips: PathBuf,
    /// Also decode these blobs of the run, in the device's arithmetic.
    #[arg(long, value_name = "FILE.kara")]
    pub blob: Vec<PathBuf>,
    /// Compare every N-th frame.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub stride: usize,
    /// One row per joint or servo instead of one per kind.
    #[arg(long)]
    pub per_group: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// How the clips are read.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// Errors of one decoder on one side of the split.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// `float`, or the blob's file and format.
    pub decoder: String,
    /// `training` or `held out`.
    pub clips: &'static str,
    /// Number of these clips.
    pub clip_count: usize,
    /// Its errors.
    #[serde(flatten)]
    pub reconstruction: Reconstruction,
}

/// One side of the split, and the codes that stand for its clips.
pub struct Side {
    name: &'static str,
    checkpoint: Checkpoint,
    data: ClipData,
}

/// Prints the errors of the float model and of every blob.
///
/// # Errors
/// Those of reading run, clips and blobs; clips that are not those of the run.
pub fn run(args: &ReconstructArgs) -> Result<()> {
    let checkpoint = Checkpoint::load(&args.run)?;
    let data = read_clip_data(&args.clips, &args.import, &checkpoint.config)?;
    if dataset_hash(&data.training.dataset) != checkpoint.state.dataset_hash {
        return Err(Error::bad_input(
            &args.clips,
            "the dataset",
            "another one than the run's",
            format!("the clips that {} was trained on, read by the same flags", args.run.display()),
            "give the same folder and flags as to train",
        ));
    }
    let blobs: Vec<Vec<u8>> =
        args.blob.iter().map(|path| read_blob(path)).collect::<Result<_>>()?;
    let mut decoders = vec![("float".to_owned(), Source::Float)];
    let models = args.blob.iter().zip(&blobs).map(|(path, blob)| load(path, blob));
    let models = models.collect::<Result<Vec<_>>>()?;
    decoders.extend(args.blob.iter().zip(&models).map(|(path, model)| {
        let format = model.number_format().name();
        (format!("{} ({format})", path.display()), Source::Blob(model))
    }));
    let sides = Side::of(checkpoint, data);
    let rows: Vec<Row> = decoders
        .iter()
        .flat_map(|(name, source)| sides.iter().map(|side| side.row(name, *source, args.stride)))
        .collect();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&rows).unwrap_or_default());
        return Ok(());
    }
    for row in &rows[..sides.len()] {
        let frame_count = thousands(row.reconstruction.frame_count as u64);
        println!("{}: {} clips, {frame_count} frames", row.clips, row.clip_count);
    }
    print!("{}", error_table(&rows, args.per_group));
    Ok(())
}

impl Side {
    /// Training clips with the codes that training learned, then held-out clips with codes that are found for them now.
    pub fn of(checkpoint: Checkpoint, data: SplitClips) -> Vec<Self> {
        let held_out = data.held_out.map(|data| Self {
            name: "held out",
            checkpoint: infer_codes(&checkpoint, &data.dataset, Progress::Bar),
            data,
        });
        let training = Self { name: "training", checkpoint, data: data.training };
        std::iter::once(training).chain(held_out).collect()
    }

    /// The errors of one decoder on every `stride`-th frame.
    pub fn row(&self, decoder: &str, source: Source<'_>, stride: usize) -> Row {
        let ClipData { dataset, bones } = &self.data;
        Row {
            decoder: decoder.to_owned(),
            clips: self.name,
            clip_count: dataset.description.clips.len(),
            reconstruction: reconstruct(&self.checkpoint, source, dataset, bones, stride),
        }
    }
}

/// One line per decoder, side and measure.
pub fn error_table(rows: &[Row], per_group: bool) -> Table {
    let mut table = Table::new(["decoder", "clips", "of", "RMS", "mean", "unit"]);
    for Row { decoder, clips, reconstruction, .. } in rows {
        let mut push = |of: &str, rms: String, mean: String, unit: &str| {
            table.push([decoder.clone(), (*clips).into(), of.into(), rms, mean, unit.into()]);
        };
        let errors = if per_group { &reconstruction.groups } else { &reconstruction.kinds };
        for error in errors {
            push(&error.of, format!("{:.3}", error.rms), format!("{:.3}", error.mean), error.unit);
        }
        let Some(joints) = reconstruction.joints else { continue };
        let measures = [
            ("joints", joints.joint_mm),
            ("root", joints.root_mm),
            ("joints, local", joints.local_mm),
        ];
        for (measure, mean) in measures {
            push(measure, String::new(), format!("{mean:.2}"), "mm");
        }
    }
    table
}
