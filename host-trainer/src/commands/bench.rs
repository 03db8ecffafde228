//! `host-trainer bench`: how fast one training step is on this machine.
//!
//! Out: milliseconds a step of the paper's network, joint updates, at two batch sizes and one and two threads; beside
//! them the fastest square matrix product of the same library and threads, and the step's share of it.
//!
//! Why here: the work is that of HumanAct12 (1190 clips, 12 actions, 147 channels) with random poses, and dense Adam
//! over everything, so that a framework's step can be measured beside it.

use core::fmt;
use std::hint::black_box;
use std::time::{Duration, Instant};

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use karakuri::{GroupKind, Unit};
use rand::RngExt;
use serde::Serialize;

use crate::checkpoint::Checkpoint;
use crate::config::{CodeRows, TrainConfig, UpdateOrder};
use crate::dataset::{ClipDescription, Dataset, DatasetDescription};
use crate::error::{Error, Result};
use crate::layout::{Group, PoseLayout};
use crate::random::{Purpose, stream};
use crate::stdout::{print, print_json};
use crate::train::step::Trainer;

/// What the user types after `bench`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  host-trainer bench --seconds 10")]
pub struct BenchArgs {
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
    /// Seconds to measure every row
    #[arg(long, default_value_t = 4.0)]
    pub seconds: f64,
}

/// Clips a batch; five frames each.
const BATCH_CLIPS: [usize; 2] = [32, 512];
const THREAD_COUNTS: [usize; 2] = [1, 2];
/// Sides of the square products; the fastest counts.
const PRODUCT_SIDES: [usize; 2] = [1024, 2048];

/// One row of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// Clips a batch.
    pub clips: usize,
    /// Frames a clip.
    pub frames: usize,
    /// Threads.
    pub threads: usize,
    /// Steps measured.
    pub steps: usize,
    /// Median time of a step.
    pub step_ms: f64,
    /// Tenth percentile: what a quiet machine would show.
    pub step_ms_p10: f64,
    /// Multiply-accumulates of the step's matrix products.
    pub step_macs: u64,
    /// Fastest square product, in multiply-accumulates: 2 operations each.
    pub peak_gflop_per_s: f64,
    /// Share of that speed at which a median step runs, everything besides the products included.
    pub share_of_peak: f64,
}

/// Measures and prints.
///
/// # Errors
/// * `BadInput` when `--seconds` is not above 0.
/// * `Io` when threads cannot be started.
pub fn run(args: &BenchArgs) -> Result<()> {
    if !(args.seconds > 0.0 && args.seconds <= 3600.0) {
        let remedy = "give the seconds for every row";
        return Err(Error::bad_input("--seconds", "value", args.seconds, "0 to 3600", remedy));
    }
    let mut rows = Vec::new();
    for threads in THREAD_COUNTS {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pool = pool.map_err(|error| {
            Error::io("start threads for", "bench")(std::io::Error::other(error))
        })?;
        pool.install(|| {
            let par = if threads > 1 { Par::rayon(threads) } else { Par::Seq };
            let peak = peak_gflop_per_s(par);
            for clips in BATCH_CLIPS {
                eprintln!("measuring {clips} clips on {threads} threads");
                rows.push(measure(clips, threads, peak, Duration::from_secs_f64(args.seconds)));
            }
            Ok(())
        })?;
    }
    if args.json { print_json(&rows) } else { print(BenchTable(&rows)) }
}

fn measure(clips: usize, threads: usize, peak: f64, duration: Duration) -> BenchRow {
    const WARM_UP_STEPS: usize = 3;
    const STEPS_MIN: usize = 10;
    let (dataset, config) = (random_dataset(), paper_config(clips));
    let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
    (0..WARM_UP_STEPS).for_each(|_| trainer.step(1.0));
    let mut times_ms = Vec::new();
    let started = Instant::now();
    while started.elapsed() < duration || times_ms.len() < STEPS_MIN {
        let step = Instant::now();
        trainer.step(1.0);
        times_ms.push(step.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    let (step_ms, step_macs) = (times_ms[times_ms.len() / 2], step_macs(&trainer));
    BenchRow {
        clips,
        frames: config.batch.frames,
        threads,
        steps: times_ms.len(),
        step_ms,
        step_ms_p10: times_ms[times_ms.len() / 10],
        step_macs,
        peak_gflop_per_s: peak,
        share_of_peak: 2.0 * step_macs as f64 / (step_ms * 1e6) / peak,
    }
}

/// Multiply-accumulates of the last step: layer 1 by its halves, the others three times a row.
fn step_macs(trainer: &Trainer<'_>) -> u64 {
    let model = &trainer.checkpoint.model;
    let (rows, moments) = (trainer.report.row_count, trainer.report.moment_count);
    let first = &model.layers[0];
    let codes = rows / trainer.checkpoint.config.batch.frames;
    let code_half = 3 * codes * model.code_count() * first.output_count;
    let time_half = 2 * moments * model.sinusoid_count() * first.output_count;
    let others: usize = model.layers[1..].iter().map(|layer| layer.weights.len()).sum();
    (code_half + time_half + 3 * rows * others) as u64
}

fn peak_gflop_per_s(par: Par) -> f64 {
    const REPETITIONS: usize = 6;
    let speed = |side: usize| {
        let left = Mat::<f32>::from_fn(side, side, |i, j| (i * 7 + j) as f32 % 13.0);
        let right = left.clone();
        let mut product = Mat::<f32>::zeros(side, side);
        let time_s = |_| {
            let started = Instant::now();
            matmul(product.as_mut(), Accum::Replace, left.as_ref(), right.as_ref(), 1.0, par);
            black_box(&product);
            started.elapsed().as_secs_f64()
        };
        let best_s = (0..REPETITIONS).map(time_s).fold(f64::INFINITY, f64::min);
        2.0 * (side as f64).powi(3) / best_s / 1e9
    };
    PRODUCT_SIDES.map(speed).into_iter().fold(0.0, f64::max)
}

fn paper_config(clips: usize) -> TrainConfig {
    let mut config = TrainConfig::preset("paper")
        .unwrap_or_else(|error| unreachable!("a test loads every preset: {error}"));
    config.batch.clips = clips;
    config.update.order = UpdateOrder::Joint;
    config.update.code_rows = CodeRows::Dense;
    config
}

/// As HumanAct12 in size; the poses are noise.
fn random_dataset() -> Dataset {
    const CLIP_COUNT: usize = 1190;
    const ACTION_COUNT: usize = 12;
    const JOINT_COUNT: usize = 24;
    const FRAME_COUNTS: core::ops::RangeInclusive<usize> = 8..=143;
    let mut rng = stream(1, Purpose::Bench, 0);
    let root = Group { name: "root".into(), kind: GroupKind::Translation, unit: Unit::Metre };
    let joint = |index| Group {
        name: format!("joint{index}"),
        kind: GroupKind::Rotation6d,
        unit: Unit::One,
    };
    let groups = core::iter::once(root).chain((0..JOINT_COUNT).map(joint)).collect();
    let layout = PoseLayout { groups };
    let channel_count = layout.channel_count();
    let clips: Vec<_> = (0..CLIP_COUNT)
        .map(|clip| ClipDescription {
            name: format!("clip{clip}"),
            action: clip % ACTION_COUNT,
            frame_count: rng.random_range(FRAME_COUNTS),
        })
        .collect();
    let first_rows = clips.iter().scan(0, |next, clip| {
        *next += clip.frame_count;
        Some(*next - clip.frame_count)
    });
    let first_rows: Vec<usize> = first_rows.collect();
    let frame_count: usize = clips.iter().map(|clip| clip.frame_count).sum();
    Dataset {
        first_rows,
        poses: (0..frame_count * channel_count).map(|_| rng.random_range(-1.0..1.0)).collect(),
        description: DatasetDescription {
            layout,
            rate_hz: 20.0,
            actions: (0..ACTION_COUNT).map(|action| format!("action{action}")).collect(),
            clips,
            held_out: Vec::new(),
            mean: vec![0.0; channel_count],
            scale: vec![1.0; channel_count],
            skeleton: None,
        },
    }
}

struct BenchTable<'a>(&'a [BenchRow]);

impl fmt::Display for BenchTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "batch    threads  steps  median ms  p10 ms  GFLOP  peak GFLOP/s  share of peak"
        )?;
        for row in self.0 {
            let batch = format!("{}x{}", row.clips, row.frames);
            let gflop = 2e-9 * row.step_macs as f64;
            writeln!(
                f,
                "{batch:<8} {:>7} {:>6} {:>10.2} {:>7.2} {gflop:>6.3} {:>13.0} {:>12.0} %",
                row.threads,
                row.steps,
                row.step_ms,
                row.step_ms_p10,
                row.peak_gflop_per_s,
                100.0 * row.share_of_peak,
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_network_on_every_row_would_be_the_papers_number_of_multiplications() {
        let (dataset, config) = (random_dataset(), paper_config(2));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        trainer.step(1.0);
        let (rows, moments) = (10, trainer.report.moment_count as u64);
        let weights: usize = trainer.checkpoint.model.layers.iter().map(|l| l.weights.len()).sum();
        assert_eq!(weights, 1_396_700);
        let saved = 3 * (rows - 2) * 256_000 + (3 * rows - 2 * moments) * 256_000;
        assert_eq!(step_macs(&trainer), 3 * rows * 1_396_700 - saved);
    }
}
