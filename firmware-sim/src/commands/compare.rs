//! `firmware-sim compare`: what does the number format cost?

use std::path::PathBuf;

use super::{print_json, progress_bar, read_blob};
use crate::checkpoint::Checkpoint;
use crate::compare::{Comparison, DRAW_POSE_COUNT, ErrorTable, Options, POSES_PER_CLIP, compare};
use crate::error::Result;
use crate::error_table::Rows;

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  firmware-sim compare runs/creature creature.kara")]
pub struct CompareArgs {
    /// Folder of `host-trainer train`
    run: PathBuf,
    /// Blob that was quantized from it
    model: PathBuf,
    /// Frames looked at per training clip, evenly spaced; all with a large number
    #[arg(long, value_name = "N", default_value_t = POSES_PER_CLIP as u32,
          value_parser = clap::value_parser!(u32).range(1..))]
    frames_per_clip: u32,
    /// Least number of poses of motions that the device draws
    #[arg(long, value_name = "N", default_value_t = DRAW_POSE_COUNT as u32,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    draw_poses: u32,
    /// A row for each channel group instead of one for each kind
    #[arg(long)]
    per_group: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the comparison.
///
/// # Errors
/// See [`Checkpoint::read`] and [`compare()`].
pub fn run(args: &CompareArgs) -> Result<()> {
    let checkpoint = Checkpoint::read(&args.run)?;
    let blob = read_blob(&args.model)?;
    let options = Options {
        poses_per_clip: args.frames_per_clip as usize,
        draw_pose_count: args.draw_poses as usize,
        rows: if args.per_group { Rows::PerGroup } else { Rows::PerKind },
    };
    let progress = progress_bar();
    progress.set_message("comparing motions");
    let comparison =
        compare(&checkpoint, &blob, options, &progress).map_err(|error| error.in_file(&args.model));
    progress.finish_and_clear();
    let comparison = comparison?;
    if args.json { print_json(&comparison) } else { print_tables(&comparison) }
}

fn print_tables(comparison: &Comparison) -> Result<()> {
    let format = comparison.number_format;
    println!("Error of {format} against the float model in f64.\n");
    let clips = &comparison.training_clips;
    println!(
        "Training clips, their own codes: {} clips, {} of {} frames, evenly spaced.",
        clips.motion_count, clips.pose_count, clips.frame_count
    );
    print_table(clips);
    let draws = &comparison.mixture_draws;
    println!(
        "\nMixture draws of the device, the same code on both sides: {} motions, {} poses.",
        draws.motion_count, draws.pose_count
    );
    print_table(draws);
    Ok(())
}

fn print_table(table: &ErrorTable) {
    let names = table.rows.iter().map(|row| row.group.chars().count());
    let width = names.chain(["group".len()]).max().unwrap_or_default();
    println!(
        "{:<width$}  {:>8}  {:<4}  {:>10}  {:>10}  {:>10}  {:>8}",
        "group", "channels", "unit", "RMS", "99 %", "max", "SNR dB"
    );
    for row in &table.rows {
        let signal_to_noise =
            row.signal_to_noise_db.map_or("exact".into(), |db| format!("{db:.1}"));
        println!(
            "{:<width$}  {:>8}  {:<4}  {:>10.5}  {:>10.5}  {:>10.5}  {:>8}",
            row.group,
            row.channel_count,
            row.unit,
            row.rms,
            row.percentile_99,
            row.max,
            signal_to_noise
        );
    }
}
