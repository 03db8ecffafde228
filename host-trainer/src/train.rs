//! Training: a dataset and a configuration become a checkpoint.
//!
//! In:  [`Dataset`], [`TrainConfig`].
//! Out: the folder of the run: `checkpoint.safetensors`, `config.toml`, `metrics.jsonl`, `loss.svg`.
//!
//! Why here: this file knows time, files and the user; `train/step.rs` knows the mathematics, `train/batch.rs` the
//! random numbers. A run of a number of steps ends in the same bytes whether it was interrupted or not, and with any
//! number of threads; a run of minutes depends on the clock and cannot promise that.

pub mod schedule;
pub mod optimizer;
pub mod metrics;

pub mod batch;
pub mod infer_codes;
pub mod step;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::atomic_file;
use crate::checkpoint::{Checkpoint, dataset_hash, hexadecimal};
use crate::config::TrainConfig;
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::train::metrics::{MetricLine, MetricLog, MetricSums, plot_losses};
use crate::train::schedule::{progress, rate_factor};
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
pub(crate) const LINE_PERIOD: Duration = Duration::from_secs(1);
/// Time between two saves: the most that a kill can lose.
pub(crate) const SAVE_PERIOD: Duration = Duration::from_secs(30);
pub(crate) const CONFIG_FILE_NAME: &str = "config.toml";
pub(crate) const PLOT_FILE_NAME: &str = "loss.svg";

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
    pool.install(|| {
        let checkpoint = open_run(dataset, config, run, options.start)?;
        let log = MetricLog::open(run, checkpoint.state.step)?;
        Run {
            sums: MetricSums::new(&dataset.description),
            trainer: Trainer::new(checkpoint, dataset),
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
        return Err(Error::bad_input(run, "dataset", "0 clips", "1 or more", remedy));
    }
    match start {
        Start::New => {
            let is_taken = run.exists()
                && fs::read_dir(run).map_or(true, |mut entries| entries.next().is_some());
            if is_taken {
                let remedy = "choose another folder, or go on with --resume";
                return Err(Error::bad_input(run, "--out", "in use", "a new folder", remedy));
            }
            let checkpoint = Checkpoint::start(dataset, config);
            fs::create_dir_all(run).map_err(Error::io("create", run))?;
            if let Err(error) = checkpoint.save(run) {
                // Best effort, and only what is empty: an attempt that failed should leave nothing behind.
                let _ = fs::remove_dir(run);
                return Err(error);
            }
            let text = config.to_toml();
            atomic_file::replace(&run.join(CONFIG_FILE_NAME), |file| {
                std::io::Write::write_all(file, text.as_bytes())
            })?;
            Ok(checkpoint)
        }
        Start::Resume => {
            if !run.join(Checkpoint::FILE_NAME).exists() {
                let remedy = "leave --resume off to start a new run, in a new folder";
                return Err(Error::bad_input(run, "checkpoint", "missing", "a run", remedy));
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
    debug_assert_eq!(checkpoint.state.config_hash, hexadecimal(&config.config_hash()));
    Ok(())
}

/// The first line of the canonical texts that differs: (left, right).
fn first_difference(left: &TrainConfig, right: &TrainConfig) -> Option<(String, String)> {
    let (left, right) = (left.to_toml(), right.to_toml());
    let mut pairs = left.lines().zip(right.lines());
    pairs.find(|(left, right)| left != right).map(|(left, right)| (left.into(), right.into()))
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
        let factor =
            rate_factor(self.trainer.checkpoint.config.schedule.shape, self.progress(&clock));
        self.write_line(&mut clock, factor)?;
        self.save(&mut clock)?;
        self.bar.finish_and_clear();
        if self.trainer.checkpoint.state.finished {
            // What is returned is what a later command will read.
            Checkpoint::load(self.run)
        } else {
            Err(Error::Interrupted { resume: self.options.resume_command.to_owned() })
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
            return Err(Error::bad_input(self.run, field, line.loss, "a finite number", remedy));
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
        let errors = line.error_rms.iter().map(|(name, error)| format!("{name} {error:.3}"));
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

pub(crate) const BAR_LENGTH: u64 = 1000;

pub(crate) fn progress_bar(progress: Progress) -> ProgressBar {
    let target = match progress {
        Progress::Bar => ProgressDrawTarget::stderr(),
        Progress::Hidden => ProgressDrawTarget::hidden(),
    };
    let bar = ProgressBar::with_draw_target(Some(BAR_LENGTH), target);
    let style = ProgressStyle::with_template("{bar:20} {percent}% {msg}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

#[cfg(test)]
pub mod synthetic;

#[cfg(test)]
mod tests {
    use super::*;
    use synthetic::{config, dataset};

    fn options(start: Start, thread_count: usize, stop: &AtomicBool) -> TrainOptions<'_> {
        TrainOptions {
            start,
            thread_count: Some(thread_count),
            stop,
            resume_command: "host-trainer train --resume",
            progress: Progress::Hidden,
        }
    }

    fn train_new(config: &TrainConfig, run: &Path) -> Result<Checkpoint> {
        train(&dataset(), config, run, &options(Start::New, 1, &AtomicBool::new(false)))
    }

    fn resume(config: &TrainConfig, run: &Path) -> Result<Checkpoint> {
        train(&dataset(), config, run, &options(Start::Resume, 1, &AtomicBool::new(false)))
    }

    fn bytes_of(run: &Path) -> Vec<u8> {
        fs::read(run.join(Checkpoint::FILE_NAME)).unwrap()
    }

    /// As a kill after some steps leaves it: a checkpoint, no more.
    fn killed_run(config: &TrainConfig, run: &Path, step_count: u64) {
        let dataset = dataset();
        let checkpoint = open_run(&dataset, config, run, Start::New).unwrap();
        let mut trainer = Trainer::new(checkpoint, &dataset);
        for step in 0..step_count {
            let done = progress(&config.budget, step, 0.0);
            trainer.step(rate_factor(config.schedule.shape, done));
        }
        trainer.checkpoint.save(run).unwrap();
    }

    const VARIANTS: [&str; 6] = [
        "",
        "[update]\norder = 'alternate'\ndecoder_step = 'epoch'\ngradient_norm_max = 0.5",
        "[update]\ncode_rows = 'dense'\n[batch]\nsampling = 'spread'",
        "[codes]\naction_variational = false\n[update]\ndecoder_step = 'epoch'",
        "[codes]\ncompose = 'add'\naction_dimensions = 4\n[update]\ndecoder_step = 'epoch'",
        "[codes]\naction_code = false",
    ];

    #[test]
    fn used_folder_is_refused_and_left_alone() {
        let run = tempfile::tempdir().unwrap();
        fs::write(run.path().join("mine"), "text").unwrap();
        let message = train_new(&config(""), run.path()).unwrap_err().to_string();
        assert!(message.contains("--resume"), "{message}");
        assert_eq!(fs::read_dir(run.path()).unwrap().count(), 1);
    }

    #[test]
    fn resuming_nothing_another_configuration_or_another_dataset_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let message = resume(&config(""), &run).unwrap_err().to_string();
        assert!(message.contains("checkpoint") && message.contains("missing"), "{message}");
        train_new(&config(""), &run).unwrap();
        let before = bytes_of(&run);
        let message = resume(&config("[adam]\nbeta1 = 0.8"), &run).unwrap_err().to_string();
        assert!(message.contains("beta1 = 0.8"), "{message}");
        let mut other = dataset();
        other.poses[7] += 0.1;
        let stop = AtomicBool::new(false);
        let refused = train(&other, &config(""), &run, &options(Start::Resume, 1, &stop));
        assert!(refused.unwrap_err().to_string().contains("dataset"));
        assert_eq!(bytes_of(&run), before);
    }

    #[test]
    fn diverged_training_names_the_remedy_and_keeps_the_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let mut broken = dataset();
        broken.poses[0] = f32::NAN;
        let stop = AtomicBool::new(false);
        let result = train(&broken, &config(""), &run, &options(Start::New, 1, &stop));
        assert!(result.unwrap_err().to_string().contains("learning_rate"));
        assert_eq!(Checkpoint::load(&run).unwrap().state.step, 0);
    }

    #[test]
    fn resumed_run_ends_in_the_same_bytes_as_an_uninterrupted_one() {
        for variant in VARIANTS {
            let config = config(variant);
            let folder = tempfile::tempdir().unwrap();
            let (whole, cut) = (folder.path().join("whole"), folder.path().join("cut"));
            train_new(&config, &whole).unwrap();
            killed_run(&config, &cut, 17);
            resume(&config, &cut).unwrap();
            assert!(bytes_of(&whole) == bytes_of(&cut), "{variant}");
        }
    }

    #[test]
    fn number_of_threads_does_not_change_the_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("one"), folder.path().join("two"));
        let stop = AtomicBool::new(false);
        let config = config("[decoder]\nhidden_widths = [300, 200]\n[batch]\nframes = 30");
        train(&dataset(), &config, &one, &options(Start::New, 1, &stop)).unwrap();
        train(&dataset(), &config, &two, &options(Start::New, 2, &stop)).unwrap();
        assert!(bytes_of(&one) == bytes_of(&two));
    }

    #[test]
    fn interrupted_run_is_saved_and_names_the_command_that_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let stop = AtomicBool::new(true);
        let result = train(&dataset(), &config(""), &run, &options(Start::New, 1, &stop));
        assert!(
            matches!(result, Err(Error::Interrupted { resume }) if resume.contains("--resume"))
        );
        let finished = resume(&config(""), &run).unwrap();
        assert_eq!((finished.state.step, finished.state.finished), (40, true));
        assert_eq!(finished, Checkpoint::load(&run).unwrap());
    }

    #[test]
    fn every_variant_learns() {
        for variant in VARIANTS {
            let budget = "[budget]\nsteps = 4000\n[adam]\ndecoder_learning_rate = 0.01";
            let config = config(&format!("{budget}\n{variant}"));
            let folder = tempfile::tempdir().unwrap();
            let run = folder.path().join("run");
            train_new(&config, &run).unwrap();
            let text = fs::read_to_string(run.join(MetricLog::FILE_NAME)).unwrap();
            let last: MetricLine = serde_json::from_str(text.lines().last().unwrap()).unwrap();
            assert!(last.reconstruction < 0.25, "{variant}: {last:?}");
            assert!(run.join(PLOT_FILE_NAME).exists() && run.join(CONFIG_FILE_NAME).exists());
        }
    }

    #[test]
    fn lines_after_the_checkpoint_are_cut_off_on_resumption() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        killed_run(&config(""), &run, 5);
        let mut log = MetricLog::open(&run, 99).unwrap();
        for step in [3, 5, 8] {
            let mut sums = MetricSums::new(&dataset().description);
            sums.add(&step::StepReport {
                squared_errors: vec![1.0; 6],
                row_count: 1,
                ..Default::default()
            });
            log.push(sums.take_line(step).unwrap()).unwrap();
        }
        let steps: Vec<u64> =
            MetricLog::open(&run, 5).unwrap().lines.iter().map(|line| line.step).collect();
        assert_eq!(steps, [3, 5]);
    }
}
