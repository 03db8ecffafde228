//! Station 4b: a trained checkpoint → one whose blob in a given number format comes closer to the float model.
//!
//! In:  the float checkpoint of a run, with the mixtures of its codes; a number format.
//! Out: a folder like that of a run: a checkpoint that `quantize` turns into a blob, `metrics.jsonl`, `loss.svg`.
//!
//! Why here: how activations are stored is settled before the first step, by the quantiser's own functions, and kept in
//! the checkpoint. So every step sees the very numbers that the blob will hold. The same run, format, seed and steps
//! end in the same bytes, interrupted or not.

pub mod device;
pub mod step;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use karakuri::NumberFormat;

use crate::atomic_file;
use crate::checkpoint::{Checkpoint, TunedActivation, Tuning};
use crate::config::ScheduleShape;
use crate::error::{Error, Result};
use crate::quantize::layer::InputScale;
use crate::quantize::sampler::code_fraction_bits;
use crate::train::metrics::{MetricLine, MetricLog, MetricSums, plot_losses};
use crate::train::optimizer::DecoderMoments;
use crate::train::schedule::rate_factor;
use crate::train::{
    BAR_LENGTH, CONFIG_FILE_NAME, LINE_PERIOD, PLOT_FILE_NAME, Progress, SAVE_PERIOD, Start,
    progress_bar,
};
use device::Device;
use step::Tuner;

/// What is tuned, and for what.
#[derive(Clone, Debug)]
pub struct TuneRequest<'a> {
    /// The float checkpoint.
    pub parent: &'a Checkpoint,
    /// SHA-256 of its file, hexadecimal.
    pub parent_hash: &'a str,
    /// The format.
    pub format: NumberFormat,
    /// How hidden activations are stored. // (hidden layer)
    pub activations: Vec<InputScale>,
    /// Steps.
    pub step_count: u64,
    /// Learning rate of the first step; it falls to 0 along a cosine.
    pub learning_rate: f64,
    /// Seed of the draws.
    pub seed: u64,
}

/// How tuning is carried out; nothing here changes what it learns.
#[derive(Clone, Copy, Debug)]
pub struct TuneOptions<'a> {
    /// Whether the folder is new or goes on.
    pub start: Start,
    /// Set from outside to make tuning save and return [`Error::Interrupted`].
    pub stop: &'a AtomicBool,
    /// The command that [`Error::Interrupted`] names.
    pub resume_command: &'a str,
    /// Whether a progress bar is drawn on stderr.
    pub progress: Progress,
}

/// A tuned checkpoint, and its error against the float model for clips' mean codes.
pub struct Tuned {
    /// Also in the folder.
    pub checkpoint: Checkpoint,
    /// Of the parent, quantised as it is. `step` 0.
    pub before: MetricLine,
    /// Of the tuned checkpoint.
    pub after: MetricLine,
}

/// Tunes; returns what `out/checkpoint.safetensors` then holds.
///
/// # Errors
/// * `BadInput` when the folder is in use, there is nothing to resume or it was begun otherwise, or the loss stops
///   being finite.
/// * `Io` when the folder cannot be written; the last saved checkpoint stands unharmed.
/// * `Interrupted` when `options.stop` was set; everything done is saved.
pub fn tune(request: &TuneRequest<'_>, out: &Path, options: &TuneOptions<'_>) -> Result<Tuned> {
    let start = begin(request);
    let checkpoint = match options.start {
        Start::New => create(&start, out)?,
        Start::Resume => resume(&start, out)?,
    };
    let before = measure(request, start);
    let tuning = tuning_of(&checkpoint);
    let log = MetricLog::open(out, tuning.step)?;
    let sums = MetricSums::new(&checkpoint.dataset);
    let tuner = request.tuner(checkpoint);
    let checkpoint = Run { tuner, log, sums, out, options }.finish(request)?;
    let after = measure(request, checkpoint.clone());
    Ok(Tuned { checkpoint, before, after })
}

impl TuneRequest<'_> {
    /// The parameters as the checkpoint keeps them, before the first step.
    fn tuning(&self) -> Tuning {
        let stored = |input: &InputScale| TunedActivation {
            scale: input.scale as f32,
            zero_point: input.zero_point,
        };
        Tuning {
            format: self.format.name().to_owned(),
            parent_hash: self.parent_hash.to_owned(),
            seed: self.seed,
            step_count: self.step_count,
            step: 0,
            learning_rate: self.learning_rate,
            activations: self.activations.iter().map(stored).collect(),
        }
    }

    fn tuner(&self, checkpoint: Checkpoint) -> Tuner<'_> {
        let hidden = tuning_of(&checkpoint).inputs(self.format);
        let bits = code_fraction_bits([&checkpoint.sequence_codes, &checkpoint.action_codes]);
        let device = Device::new(self.format, &checkpoint.model, hidden, bits);
        Tuner::new(checkpoint, &self.parent.model, device)
    }
}

impl Tuning {
    /// How the hidden layers' activations are stored. // (hidden layer)
    pub fn inputs(&self, format: NumberFormat) -> Vec<InputScale> {
        let (low, high) = format.activation_range();
        let magnitude_max = i64::from(low).abs().max(i64::from(high));
        let input = |stored: &TunedActivation| InputScale {
            scale: f64::from(stored.scale),
            zero_point: stored.zero_point,
            magnitude_max,
        };
        self.activations.iter().map(input).collect()
    }
}

/// The parent with a fresh optimiser, marked as tuned by 0 steps.
fn begin(request: &TuneRequest<'_>) -> Checkpoint {
    let mut checkpoint = request.parent.clone();
    checkpoint.optimizer.decoder = DecoderMoments::zeros(&checkpoint.model.layers);
    checkpoint.state.tuning = Some(request.tuning());
    checkpoint
}

/// Only checkpoints that [`begin`] or [`resume`] made come here.
fn tuning_of(checkpoint: &Checkpoint) -> &Tuning {
    match &checkpoint.state.tuning {
        Some(tuning) => tuning,
        None => unreachable!("marked when tuning began"),
    }
}

fn create(start: &Checkpoint, out: &Path) -> Result<Checkpoint> {
    let is_taken =
        out.exists() && fs::read_dir(out).map_or(true, |mut entries| entries.next().is_some());
    if is_taken {
        let remedy = "choose another folder, or go on with --resume";
        return Err(Error::bad_input(out, "--out", "in use", "a new folder", remedy));
    }
    fs::create_dir_all(out).map_err(Error::io("create", out))?;
    if let Err(error) = start.save(out) {
        // Best effort, and only what is empty: an attempt that failed should leave nothing behind.
        let _ = fs::remove_dir(out);
        return Err(error);
    }
    let text = start.config.to_toml();
    atomic_file::replace(&out.join(CONFIG_FILE_NAME), |file| {
        std::io::Write::write_all(file, text.as_bytes())
    })?;
    Ok(start.clone())
}

/// The saved checkpoint, if it was begun as this request would.
fn resume(start: &Checkpoint, out: &Path) -> Result<Checkpoint> {
    if !out.join(Checkpoint::FILE_NAME).exists() {
        let remedy = "leave --resume off to start, in a new folder";
        return Err(Error::bad_input(out, "checkpoint", "missing", "a tuned run", remedy));
    }
    let checkpoint = Checkpoint::load(out)?;
    let Some(then) = &checkpoint.state.tuning else {
        let remedy = "give the --out of an interrupted `host-trainer tune`";
        return Err(Error::bad_input(out, "checkpoint", "not tuned", "a tuned run", remedy));
    };
    let now = tuning_of(start);
    let facts = [
        ("format", now.format.clone(), then.format.clone()),
        ("hash of RUN", now.parent_hash.clone(), then.parent_hash.clone()),
        ("--seed", now.seed.to_string(), then.seed.to_string()),
        ("--steps", now.step_count.to_string(), then.step_count.to_string()),
        ("--learning-rate", now.learning_rate.to_string(), then.learning_rate.to_string()),
    ];
    match facts.into_iter().find(|(_, now, then)| now != then) {
        None => Ok(checkpoint),
        Some((field, now, then)) => {
            let expected = format!("{then}, as when it began");
            let remedy = "repeat the first command with --resume, or choose another --out";
            Err(Error::bad_input(out, field, now, expected, remedy))
        }
    }
}

/// The error of a checkpoint in the device's arithmetic.
fn measure(request: &TuneRequest<'_>, checkpoint: Checkpoint) -> MetricLine {
    let mut sums = MetricSums::new(&checkpoint.dataset);
    let step = tuning_of(&checkpoint).step;
    let mut tuner = request.tuner(checkpoint);
    tuner.measure();
    sums.add(&tuner.report);
    match sums.take_line(step) {
        Some(line) => line,
        None => unreachable!("one report was added"),
    }
}

/// Tuning in progress.
struct Run<'a> {
    tuner: Tuner<'a>,
    log: MetricLog,
    sums: MetricSums,
    out: &'a Path,
    options: &'a TuneOptions<'a>,
}

impl Run<'_> {
    fn finish(mut self, request: &TuneRequest<'_>) -> Result<Checkpoint> {
        let bar = progress_bar(self.options.progress);
        let (mut line_time, mut save_time) = (Instant::now(), Instant::now());
        let mut line_step = tuning_of(&self.tuner.checkpoint).step;
        for step in line_step..request.step_count {
            if self.options.stop.load(Ordering::Relaxed) {
                self.save()?;
                return Err(Error::Interrupted { resume: self.options.resume_command.to_owned() });
            }
            let done = step as f64 / request.step_count as f64;
            let rate = request.learning_rate * rate_factor(ScheduleShape::Cosine, done);
            self.tuner.step(request.seed, step, rate);
            if let Some(tuning) = &mut self.tuner.checkpoint.state.tuning {
                tuning.step = step + 1;
            }
            self.sums.add(&self.tuner.report);
            if line_time.elapsed() >= LINE_PERIOD || step + 1 == request.step_count {
                let speed = (step + 1 - line_step) as f64 / line_time.elapsed().as_secs_f64();
                let message = self.write_line(step + 1, rate, speed)?;
                bar.set_message(message);
                bar.set_position((done * BAR_LENGTH as f64) as u64);
                (line_time, line_step) = (Instant::now(), step + 1);
            }
            if save_time.elapsed() >= SAVE_PERIOD {
                self.save()?;
                save_time = Instant::now();
            }
        }
        self.save()?;
        bar.finish_and_clear();
        Checkpoint::load(self.out)
    }

    /// Appends to the log; returns the line for people.
    fn write_line(&mut self, step: u64, rate: f64, steps_per_s: f64) -> Result<String> {
        let Some(mut line) = self.sums.take_line(step) else {
            return Ok(String::new());
        };
        if !line.loss.is_finite() {
            let field = format!("loss at step {step}");
            let remedy = "lower --learning-rate";
            return Err(Error::bad_input(self.out, field, line.loss, "a finite number", remedy));
        }
        (line.decoder_learning_rate, line.steps_per_s) = (rate, steps_per_s);
        let errors = line.error_rms.iter().map(|(name, error)| format!("{name} {error:.4}"));
        let errors = errors.collect::<Vec<_>>().join(", ");
        self.log.push(line)?;
        Ok(format!("step {step}, off the float model by {errors}, {steps_per_s:.1} steps/s"))
    }

    fn save(&self) -> Result<()> {
        self.tuner.checkpoint.save(self.out)?;
        plot_losses(&self.log.lines, &self.out.join(PLOT_FILE_NAME))
    }
}
