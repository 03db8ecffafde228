//! Training: a dataset and a configuration become a checkpoint.
//!
//! In:  [`Dataset`], [`TrainConfig`].
//! Out: the folder of the run: `checkpoint.safetensors`, `config.toml`, `metrics.jsonl`, `loss.svg`.
//!
//! Why here: this file knows time, files and the user; `train/step.rs` knows the mathematics, `train/batch.rs` the
//! random numbers. A run of a number of steps ends in the same bytes whether it was interrupted or not, and with any
//! number of threads; a run of minutes depends on the clock and cannot promise that.

pub mod batch;
pub mod step;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use faer::Par;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::atomic_file;
use crate::checkpoint::{Checkpoint, dataset_hash, hexadecimal};
use crate::config::TrainConfig;
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::metrics::{MetricLine, MetricLog, MetricSums, plot_losses};
use crate::schedule::{progress, rate_factor};
use step::Trainer;

/// How a run is carried out; nothing here changes what a run of steps learns.
#[derive(Clone, Copy, Debug)]
pub struct TrainOptions<'a> {
    /// Whether the folder is new or goes on.
    pub start: Start,
    /// Threads; `None`: one per core.
    pub thread_count: Option<usize>,
    /// Set from outside to make training save and return [`Error::Interrupted`].
    pub stop: &'a AtomicBool,
    /// The command that [`Error::Interrupted`] names.
    pub resume_command: &'a str,
    /// Whether a progress bar is drawn on stderr.
    pub progress: Progress,
}

/// Whether a run is new.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// The folder must not exist, or be empty.
    New,
    /// The folder holds the checkpoint to go on from.
    Resume,
}

/// Whether progress is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// As a bar on stderr.
    Bar,
    /// Not at all.
    Hidden,
}

/// Time between two lines of `metrics.jsonl`.
const LINE_PERIOD: Duration = Duration::from_secs(1);
/// Time between two saves: the most that a kill can lose.
const SAVE_PERIOD: Duration = Duration::from_secs(30);
const CONFIG_FILE_NAME: &str = "config.toml";
const PLOT_FILE_NAME: &str = "loss.svg";

/// Trains until the budget is used up; returns what `run/checkpoint.safetensors` then holds.
///
/// # Errors
/// * `BadInput` when the folder exists and is not to be resumed, when there is nothing to resume, when configuration or
///   dataset differ from those of the checkpoint, when the dataset is empty, or when the loss stops being finite.
/// * `Io` when the folder cannot be written; the last saved checkpoint stands unharmed.
/// * `Interrupted` when `options.stop` was set; everything done is saved.
pub fn train(
    dataset: &Dataset,
    config: &TrainConfig,
    run: &Path,
    options: &TrainOptions<'_>,
) -> Result<Checkpoint> {
    let mut threads = rayon::ThreadPoolBuilder::new();
    if let Some(thread_count) = options.thread_count {
        threads = threads.num_threads(thread_count);
    }
    let no_threads = |error| Error::io("start threads for", run)(std::io::Error::other(error));
    let pool = threads.build().map_err(no_threads)?;
    let par = if pool.current_num_threads() > 1 {
        Par::rayon(pool.current_num_threads())
    } else {
        Par::Seq
    };
    pool.install(|| {
        let checkpoint = open_run(dataset, config, run, options.start)?;
        let log = MetricLog::open(run, checkpoint.state.step)?;
        Run {
            sums: MetricSums::new(&dataset.description),
            trainer: Trainer::new(checkpoint, dataset, par),
            log,
            run,
            options,
            bar: progress_bar(options.progress),
        }
        .finish()
    })
}

/// The checkpoint to start from: a new folder's at step 0, or the saved one.
fn open_run(
    dataset: &Dataset,
    config: &TrainConfig,
    run: &Path,
    start: Start,
) -> Result<Checkpoint> {
    if dataset.description.clips.is_empty() {
        let remedy = "give at least one clip of at least one pose";
        return Err(Error::bad_input(
            run,
            "dataset",
            "0 clips",
            "1 or more",
            remedy,
        ));
    }
    match start {
        Start::New => {
            let is_taken = run.exists()
                && fs::read_dir(run).map_or(true, |mut entries| entries.next().is_some());
            if is_taken {
                let remedy = "choose another folder, or go on with --resume";
                return Err(Error::bad_input(
                    run,
                    "--out",
                    "in use",
                    "a new folder",
                    remedy,
                ));
            }
            let checkpoint = Checkpoint::start(dataset, config);
            fs::create_dir_all(run).map_err(Error::io("create", run))?;
            checkpoint.save(run)?;
            let text = config.to_toml();
            atomic_file::replace(&run.join(CONFIG_FILE_NAME), |file| {
                std::io::Write::write_all(file, text.as_bytes())
            })?;
            Ok(checkpoint)
        }
        Start::Resume => {
            if !run.join(Checkpoint::FILE_NAME).exists() {
                let remedy = "leave --resume off to start a new run, in a new folder";
                return Err(Error::bad_input(
                    run,
                    "checkpoint",
                    "missing",
                    "a run",
                    remedy,
                ));
            }
            let mut checkpoint = Checkpoint::load(run)?;
            refuse_other_run(&checkpoint, dataset, config, run)?;
            // The same facts, but free of the last-digit rounding of a trip through JSON.
            checkpoint.dataset = dataset.description.clone();
            Ok(checkpoint)
        }
    }
}

/// A run goes on only with the configuration and the data that it began with.
fn refuse_other_run(
    checkpoint: &Checkpoint,
    dataset: &Dataset,
    config: &TrainConfig,
    run: &Path,
) -> Result<()> {
    let differs = |field: &str, now: String, then: &str, remedy: &str| {
        let expected = format!("{then}, as when the run began");
        Err(Error::bad_input(run, field, now, expected, remedy))
    };
    if let Some((now, then)) = first_difference(config, &checkpoint.config) {
        let remedy = "repeat the flags of the first command, or start a new run in another --out";
        return differs("configuration", now, &then, remedy);
    }
    let hash = dataset_hash(dataset);
    if hash != checkpoint.state.dataset_hash {
        let remedy = "restore the clips and the import flags, or start a new run in another --out";
        return differs("dataset", hash, &checkpoint.state.dataset_hash, remedy);
    }
    debug_assert_eq!(
        checkpoint.state.config_hash,
        hexadecimal(&config.config_hash())
    );
    Ok(())
}

/// The first line of the canonical texts that differs: (left, right).
fn first_difference(left: &TrainConfig, right: &TrainConfig) -> Option<(String, String)> {
    let (left, right) = (left.to_toml(), right.to_toml());
    let mut pairs = left.lines().zip(right.lines());
    pairs
        .find(|(left, right)| left != right)
        .map(|(left, right)| (left.into(), right.into()))
}

/// A run in progress.
struct Run<'a> {
    trainer: Trainer<'a>,
    sums: MetricSums,
    log: MetricLog,
    run: &'a Path,
    options: &'a TrainOptions<'a>,
    bar: ProgressBar,
}

/// Moments that the loop compares with.
struct Clock {
    elapsed_before_s: f64,
    progress_before: f64,
    started: Instant,
    line: Instant,
    line_step: u64,
    save: Instant,
}

impl Run<'_> {
    fn finish(mut self) -> Result<Checkpoint> {
        let Checkpoint { config, state, .. } = &self.trainer.checkpoint;
        let now = Instant::now();
        let mut clock = Clock {
            elapsed_before_s: state.elapsed_s,
            progress_before: progress(&config.budget, state.step, state.elapsed_s),
            started: now,
            line: now,
            line_step: state.step,
            save: now,
        };
        loop {
            let done = self.progress(&clock);
            if done >= 1.0 {
                self.trainer.checkpoint.state.finished = true;
                break;
            }
            if self.options.stop.load(Ordering::Relaxed) {
                break;
            }
            let factor = rate_factor(self.trainer.checkpoint.config.schedule.shape, done);
            self.trainer.step(factor);
            self.sums.add(&self.trainer.report);
            if clock.line.elapsed() >= LINE_PERIOD {
                self.write_line(&mut clock, factor)?;
            }
            if clock.save.elapsed() >= SAVE_PERIOD {
                self.save(&mut clock)?;
            }
        }
        let factor = rate_factor(
            self.trainer.checkpoint.config.schedule.shape,
            self.progress(&clock),
        );
        self.write_line(&mut clock, factor)?;
        self.save(&mut clock)?;
        self.bar.finish_and_clear();
        if self.trainer.checkpoint.state.finished {
            Ok(self.trainer.checkpoint)
        } else {
            Err(Error::Interrupted {
                resume: self.options.resume_command.to_owned(),
            })
        }
    }

    fn progress(&self, clock: &Clock) -> f64 {
        let Checkpoint { config, state, .. } = &self.trainer.checkpoint;
        progress(&config.budget, state.step, clock.elapsed_s())
    }

    fn write_line(&mut self, clock: &mut Clock, factor: f64) -> Result<()> {
        let Checkpoint { config, state, .. } = &self.trainer.checkpoint;
        let Some(mut line) = self.sums.take_line(state.step) else {
            return Ok(());
        };
        if !line.loss.is_finite() {
            let field = format!("loss at step {}", state.step);
            let remedy = "lower adam.*_learning_rate or set update.gradient_norm_max; \
                          the checkpoint before this is kept";
            return Err(Error::bad_input(
                self.run,
                field,
                line.loss,
                "a finite number",
                remedy,
            ));
        }
        line.decoder_learning_rate = config.adam.decoder_learning_rate * factor;
        line.code_learning_rate = config.adam.code_learning_rate * factor;
        line.steps_per_s =
            (state.step - clock.line_step) as f64 / clock.line.elapsed().as_secs_f64();
        (clock.line, clock.line_step) = (Instant::now(), state.step);
        self.show(&line, self.progress(clock), clock);
        self.log.push(line)
    }

    fn show(&self, line: &MetricLine, done: f64, clock: &Clock) {
        let errors = line
            .error_rms
            .iter()
            .map(|(name, error)| format!("{name} {error:.3}"));
        let errors = errors.collect::<Vec<_>>().join(", ");
        let done_now = (done - clock.progress_before).max(f64::EPSILON);
        let left_s = clock.started.elapsed().as_secs_f64() * (1.0 - done) / done_now;
        self.bar.set_position((done * BAR_LENGTH as f64) as u64);
        self.bar.set_message(format!(
            "step {}, loss {:.5}, {errors}, KL {:.5}, {:.1} steps/s, {} left",
            line.step,
            line.loss,
            line.divergence,
            line.steps_per_s,
            indicatif::HumanDuration(Duration::from_secs_f64(left_s.clamp(0.0, 1e9))),
        ));
    }

    fn save(&mut self, clock: &mut Clock) -> Result<()> {
        let state = &mut self.trainer.checkpoint.state;
        if self.trainer.checkpoint.config.budget.minutes > 0.0 {
            state.elapsed_s = clock.elapsed_s();
        }
        self.trainer.checkpoint.save(self.run)?;
        plot_losses(&self.log.lines, &self.run.join(PLOT_FILE_NAME))?;
        clock.save = Instant::now();
        Ok(())
    }
}

impl Clock {
    fn elapsed_s(&self) -> f64 {
        self.elapsed_before_s + self.started.elapsed().as_secs_f64()
    }
}

const BAR_LENGTH: u64 = 1000;

fn progress_bar(progress: Progress) -> ProgressBar {
    let target = match progress {
        Progress::Bar => ProgressDrawTarget::stderr(),
        Progress::Hidden => ProgressDrawTarget::hidden(),
    };
    let bar = ProgressBar::with_draw_target(Some(BAR_LENGTH), target);
    let style = ProgressStyle::with_template("{bar:20} {percent}% {msg}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
