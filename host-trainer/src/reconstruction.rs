//! How well the decoder gives the training clips back.
//!
//! In:  a [`Checkpoint`] and the [`Dataset`] that it was trained on.
//! Out: [`ReconstructionReport`]: errors in real units, one row a kind of channel.
//!
//! Why here: training reports the error of noisy codes on random frames; this is the error of mean codes on every
//! frame, the figure to compare float and quantised decoders by.

use core::fmt;

use karakuri::GroupKind;
use rayon::prelude::*;

use crate::checkpoint::Checkpoint;
use crate::dataset::Dataset;
use crate::metrics::{ErrorColumn, error_columns};

/// Errors over every frame of every training clip, decoded from the mean codes.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructionReport {
    /// One row a kind and unit.
    pub rows: Vec<ReconstructionRow>,
}

/// Errors of all channels of one kind and unit.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructionRow {
    /// Kind and unit, e.g. `position_mm`; the unit is that of the errors.
    pub name: String,
    /// Root of the mean square of every channel.
    pub rms: f64,
    /// For translations (the root) and positions (the other joints, relative to it): the mean distance, over all joints
    /// and frames, between the decoded and the true point.
    pub mean_distance: Option<f64>,
}

/// Sums of one clip for one column.
#[derive(Clone, Copy, Default)]
struct Sums {
    squares: f64,
    distances: f64,
}

/// Decodes every frame of every clip from its mean codes and compares it with the clip.
pub fn reconstruction_error(checkpoint: &Checkpoint, dataset: &Dataset) -> ReconstructionReport {
    let columns = error_columns(&dataset.description);
    let clip_count = dataset.description.clips.len();
    let per_clip: Vec<Vec<Sums>> = (0..clip_count)
        .into_par_iter()
        .map(|clip| clip_sums(checkpoint, dataset, &columns, clip))
        .collect();
    let frame_count: usize = dataset.description.clips.iter().map(|clip| clip.frame_count).sum();
    let row = |(index, column): (usize, &ErrorColumn)| {
        let sum = |of: fn(&Sums) -> f64| per_clip.iter().map(|sums| of(&sums[index])).sum::<f64>();
        let value_count = (frame_count * column.channels.len()) as f64;
        let point_count = value_count / column.kind.channel_count() as f64;
        ReconstructionRow {
            name: column.name.clone(),
            rms: (sum(|sums| sums.squares) / value_count).sqrt(),
            mean_distance: is_point(column.kind)
                .then(|| sum(|sums| sums.distances) / point_count),
        }
    };
    ReconstructionReport { rows: columns.iter().enumerate().map(row).collect() }
}

fn clip_sums(
    checkpoint: &Checkpoint,
    dataset: &Dataset,
    columns: &[ErrorColumn],
    clip: usize,
) -> Vec<Sums> {
    let description = &dataset.description;
    let channel_count = description.layout.channel_count();
    let frame_count = description.clips[clip].frame_count;
    let times_frames: Vec<f64> = (0..frame_count).map(|frame| frame as f64).collect();
    let mut poses = vec![0.0; frame_count * channel_count];
    checkpoint.model.decode_motion(&checkpoint.mean_code(clip), &times_frames, &mut poses);
    let targets = dataset.clip_poses(clip);
    let mut sums = vec![Sums::default(); columns.len()];
    for (pose, target) in poses.chunks_exact(channel_count).zip(targets.chunks_exact(channel_count)) {
        for (column, sums) in columns.iter().zip(&mut sums) {
            for group in column.channels.chunks_exact(column.kind.channel_count()) {
                let square = |&channel: &usize| {
                    let scale = f64::from(description.scale[channel]) * column.factor;
                    (f64::from(pose[channel] - target[channel]) * scale).powi(2)
                };
                let squares: f64 = group.iter().map(square).sum();
                sums.squares += squares;
                sums.distances += squares.sqrt();
            }
        }
    }
    sums
}

/// Whether a group of this kind is a point in space.
fn is_point(kind: GroupKind) -> bool {
    matches!(kind, GroupKind::Translation | GroupKind::Position)
}

impl fmt::Display for ReconstructionReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<20} {:>12} {:>14}", "error of", "rms/channel", "mean distance")?;
        for row in &self.rows {
            write!(f, "{:<20} {:>12.4}", row.name, row.rms)?;
            match row.mean_distance {
                Some(distance) => writeln!(f, " {distance:>14.4}")?,
                None => writeln!(f, " {:>14}", "")?,
            }
        }
        Ok(())
    }
}
