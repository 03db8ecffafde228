//! Station 4b: a trained checkpoint → one whose blob in a given number format comes closer to the float model.
//!
//! In:  the float checkpoint of a run, with the mixtures of its codes; a number format.
//! Out: a folder like that of a run: a checkpoint that `quantize` turns into a blob, `metrics.jsonl`, `loss.svg`.
//!
//! Why here: how activations are stored is settled before the first step, by the quantiser's own functions, and kept in
//! the checkpoint. So every step sees the very weights that the blob will hold; of gates
//! and phases, what the device rounds once a motion comes on top. The same run, format, seed and steps
//! end in the same bytes, interrupted or not.

pub mod device;
pub mod folder;
pub mod step;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use karakuri::NumberFormat;
use karakuri::manifest::WeightFormat;

use crate::checkpoint::{Checkpoint, TunedActivation, Tuning};
use crate::config::ScheduleShape;
use crate::error::{Error, Result};
use crate::quantize::default_weights;
use crate::quantize::flash_budget::weight_format;
use crate::quantize::layer::InputScale;
use crate::quantize::sampler::code_fraction_bits;
use crate::quantize::split::split_layers;
use crate::train::metrics::{MetricLine, MetricLog, MetricSums, plot_losses};
use crate::train::optimizer::DecoderMoments;
use crate::train::schedule::rate_factor;
use crate::train::{
    BAR_LENGTH, LINE_PERIOD, PLOT_FILE_NAME, Progress, SAVE_PERIOD, Start, progress_bar,
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
    /// Bits of each layer's weights (code half, time half, the others); empty: those of the format by default.
    pub weight_bits: Vec<u8>,
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
        Start::New => folder::create(&start, out)?,
        Start::Resume => folder::resume(&start, out)?,
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
            weight_bits: self.weight_bits.clone(),
        }
    }

    fn tuner(&self, checkpoint: Checkpoint) -> Tuner<'_> {
        let tuning = tuning_of(&checkpoint);
        let (hidden, weights) = (tuning.inputs(self.format), tuning.weights());
        let bits = code_fraction_bits([&checkpoint.sequence_codes, &checkpoint.action_codes]);
        let Checkpoint { model, dataset, .. } = &checkpoint;
        let weights =
            weights.unwrap_or_else(|| default_weights(self.format, &split_layers(model, dataset)));
        let device = Device::new(self.format, model, weights, hidden, bits);
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

    /// How the weights of each layer are stored; `None`: as the format has it by default.
    pub fn weights(&self) -> Option<Vec<WeightFormat>> {
        let weights = self.weight_bits.iter().copied().map(weight_format).collect::<Vec<_>>();
        (!weights.is_empty()).then_some(weights)
    }
}

/// The parent with a fresh optimiser, marked as tuned by 0 steps.
fn begin(request: &TuneRequest<'_>) -> Checkpoint {
    let mut checkpoint = request.parent.clone();
    checkpoint.optimizer.decoder = DecoderMoments::zeros(checkpoint.model.trained_layers());
    checkpoint.state.tuning = Some(request.tuning());
    checkpoint
}

/// Only checkpoints that [`begin`] or [`folder::resume`] made come here.
fn tuning_of(checkpoint: &Checkpoint) -> &Tuning {
    match &checkpoint.state.tuning {
        Some(tuning) => tuning,
        None => unreachable!("marked when tuning began"),
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
        let first_step = tuning_of(&self.tuner.checkpoint).step;
        let mut line_step = first_step;
        for step in first_step..request.step_count {
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

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use karakuri::{Decoder, FramePosition, Model, Pose, Workspace};

    use super::*;
    use crate::commands::quantize::quantize_checkpoint;
    use crate::mixture::fit::fit;
    use crate::quantize::calibrate::{CalibrationCase, calibrate};
    use crate::quantize::{QuantizeOptions, activation_scales};
    use crate::train::step::Trainer;
    use crate::train::synthetic::{config, dataset};

    const FORMATS: [NumberFormat; 3] =
        [NumberFormat::W8A16, NumberFormat::W8A8, NumberFormat::W4A8];

    fn trained() -> Checkpoint {
        trained_with("")
    }

    fn trained_with(overrides: &str) -> Checkpoint {
        const RATES: &str = "[adam]\ndecoder_learning_rate = 0.01\ncode_learning_rate = 0.01\n";
        let (dataset, config) = (dataset(), config(&format!("{RATES}{overrides}")));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        (0..500).for_each(|_| trainer.step(1.0));
        trainer.checkpoint
    }

    fn request(parent: &Checkpoint, format: NumberFormat, step_count: u64) -> TuneRequest<'_> {
        let case = |clip| CalibrationCase {
            code: parent.mean_code(clip),
            frames: (0..12).map(f64::from).collect(),
        };
        let cases: Vec<CalibrationCase> = (0..parent.dataset.clips.len()).map(case).collect();
        TuneRequest {
            parent,
            parent_hash: "parent",
            format,
            activations: activation_scales(&calibrate(&parent.model, &cases), format),
            weight_bits: Vec::new(),
            step_count,
            learning_rate: 1e-3,
            seed: 5,
        }
    }

    fn run(request: &TuneRequest<'_>, out: &Path, start: Start, stop: bool) -> Result<Tuned> {
        let options = TuneOptions {
            start,
            stop: &AtomicBool::new(stop),
            resume_command: "host-trainer tune --resume",
            progress: Progress::Hidden,
        };
        tune(request, out, &options)
    }

    fn message(result: Result<Tuned>) -> String {
        result.err().map_or_else(String::new, |error| error.to_string())
    }

    fn folder() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        (folder, out)
    }

    #[test]
    fn used_folder_is_refused_and_left_alone() {
        let (folder, parent) = (tempfile::tempdir().unwrap(), trained());
        fs::write(folder.path().join("mine"), "text").unwrap();
        let request = request(&parent, NumberFormat::W8A8, 3);
        let message = message(run(&request, folder.path(), Start::New, false));
        assert!(message.contains("--resume"), "{message}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn resuming_nothing_an_untuned_run_or_another_tuning_is_refused() {
        let ((_folder, out), parent) = (folder(), trained());
        let request = request(&parent, NumberFormat::W8A8, 3);
        assert!(message(run(&request, &out, Start::Resume, false)).contains("missing"));
        fs::create_dir(&out).unwrap();
        parent.save(&out).unwrap();
        assert!(message(run(&request, &out, Start::Resume, false)).contains("not tuned"));
        fs::remove_dir_all(&out).unwrap();
        run(&request, &out, Start::New, false).unwrap();
        let others = [
            ("--seed", TuneRequest { seed: 6, ..request.clone() }),
            ("--steps", TuneRequest { step_count: 4, ..request.clone() }),
            ("bits of weights", TuneRequest { weight_bits: vec![8; 4], ..request.clone() }),
            ("hash of RUN", TuneRequest { parent_hash: "another", ..request.clone() }),
        ];
        for (field, other) in others {
            let message = message(run(&other, &out, Start::Resume, false));
            assert!(message.contains(field) && message.contains("as when it began"), "{message}");
        }
    }

    #[test]
    fn interrupted_tuning_ends_in_the_same_bytes() {
        let parent = trained();
        let request = request(&parent, NumberFormat::W8A8, 20);
        let ((_folder, whole), (_other, cut)) = (folder(), folder());
        run(&request, &whole, Start::New, false).unwrap();
        assert!(matches!(run(&request, &cut, Start::New, true), Err(Error::Interrupted { .. })));
        // As a kill after some steps leaves it.
        let mut tuner = request.tuner(folder::resume(&begin(&request), &cut).unwrap());
        for step in 0..7 {
            let rate =
                request.learning_rate * rate_factor(ScheduleShape::Cosine, step as f64 / 20.0);
            tuner.step(request.seed, step, rate);
        }
        tuner.checkpoint.state.tuning.as_mut().unwrap().step = 7;
        tuner.checkpoint.save(&cut).unwrap();
        run(&request, &cut, Start::Resume, false).unwrap();
        let bytes = |out: &Path| fs::read(out.join(Checkpoint::FILE_NAME)).unwrap();
        assert!(bytes(&whole) == bytes(&cut));
    }

    #[test]
    fn tuning_lessens_the_error_and_leaves_codes_and_shape_alone() {
        let parent = trained();
        // In so small a model the rounding of weights costs nothing beside that of 8-bit activations, so not w8a8.
        for (format, learning_rate) in [(NumberFormat::W8A16, 1e-4), (NumberFormat::W4A8, 1e-3)] {
            let (_folder, out) = folder();
            let request = TuneRequest { learning_rate, ..request(&parent, format, 500) };
            let tuned = run(&request, &out, Start::New, false).unwrap();
            let (before, after) = (tuned.before.loss, tuned.after.loss);
            assert!(after < before, "{}: {before} became {after}", format.name());
            assert_eq!(tuned.checkpoint.sequence_codes, parent.sequence_codes);
            assert_eq!(tuned.checkpoint.action_codes, parent.action_codes);
            assert_eq!(tuned.checkpoint.config, parent.config);
        }
    }

    /// Channels of a clip's frame, in channel units, by the blob.
    fn decode(blob: &[u8], code: &[f32], frame: u32) -> Vec<f64> {
        let model = Model::from_bytes(blob).unwrap();
        let mut workspace = Workspace::<128>::new();
        let mut decoder = Decoder::new(&model, &mut workspace).unwrap();
        decoder.start(&model.code_from_f32(code));
        let mut pose = Pose::new();
        decoder.decode(FramePosition::from_frames(frame), &mut pose);
        pose.channels().iter().map(|&channel| f64::from(channel) / 65_536.0).collect()
    }

    #[test]
    fn tuned_checkpoint_quantises_to_the_very_weights_that_tuning_saw() {
        let parent = trained_with("[decoder]\nmodulation = 'none'");
        let cases = FORMATS.map(|format| (format, vec![]));
        // Code half, time half, two others: the device may mix bits as it likes.
        let mixed = [vec![4, 8, 8, 4], vec![8, 4, 4, 8]].map(|bits| (NumberFormat::W4A8, bits));
        for (format, weight_bits) in cases.into_iter().chain(mixed) {
            let (_folder, out) = folder();
            let request = TuneRequest { weight_bits, ..request(&parent, format, 50) };
            let start = folder::create(&begin(&request), &out).unwrap();
            let mut tuner = request.tuner(start);
            (0..50).for_each(|step| tuner.step(1, step, 1e-3));
            tuner.checkpoint.save(&out).unwrap();
            let loaded = Checkpoint::load(&out).unwrap();
            assert_eq!(request.tuner(loaded.clone()).effective_model(), tuner.effective_model());
            let mixture = &loaded.config.mixture;
            let mixtures = fit(&loaded.sequence_codes, &loaded.dataset, mixture, 1).unwrap();
            let options = QuantizeOptions::new(format);
            let blob = quantize_checkpoint("tuned", &loaded, &mixtures, &options).unwrap().blob;
            assert_blob_gives_the_poses_that_tuning_saw(&tuner, &blob);
        }
    }

    /// Up to activations on the edge between two steps, which f32 and integers may round to different sides.
    fn assert_blob_gives_the_poses_that_tuning_saw(tuner: &Tuner<'_>, blob: &[u8]) {
        let (mut apart, mut lost, mut count) = (0.0, 0.0, 0.0);
        for clip in 0..tuner.checkpoint.dataset.clips.len() {
            let code = tuner.checkpoint.mean_code(clip);
            for frame in 0..3 {
                let [mut seen, mut wanted] = tuner.decode(&code, frame);
                tuner.checkpoint.dataset.destandardize(&mut seen);
                tuner.checkpoint.dataset.destandardize(&mut wanted);
                let got = decode(blob, &code, frame as u32);
                for ((got, seen), wanted) in got.iter().zip(&seen).zip(&wanted) {
                    apart += (got - f64::from(*seen)).powi(2);
                    lost += f64::from(wanted - seen).powi(2);
                    count += 1.0;
                }
            }
        }
        let (apart, lost) = ((apart / count).sqrt(), (lost / count).sqrt());
        assert!(apart < 0.15 * lost + 1e-4, "{apart} apart, {lost} from the float model");
    }
}
