//! One step of tuning: the device's arithmetic learns to give the poses of the float model.
//!
//! In:  the tuned checkpoint as it stands, the float model that it began as.
//! Out: the checkpoint one step later, and what the step measured.
//!
//! Why here: the targets are the float model's own poses, so tuning needs no clips, cannot learn them by heart, and
//! leaves the codes alone, with everything that was fitted to them.
//!
//! Source: Bengio et al. 2013 and Jacob et al., CVPR 2018, for gradients that pass rounding as if it were not there;
//! Hinton et al. 2015 for the targets.

use faer::Accum;

use crate::checkpoint::Checkpoint;
use crate::config::TrainConfig;
use crate::dataset::{Dataset, DatasetDescription};
use crate::float_model::{FloatModel, Rows, Wanted, Workspace};
use crate::simd::vectorized;
use crate::train::batch::Batch;
use crate::train::optimizer::Adam;
use crate::train::step::{StepReport, channel_weights};
use crate::tune::device::Device;

/// Frames of a clip that [`Tuner::measure`] decodes.
const MEASURED_FRAMES: usize = 8;
/// Clips that it decodes, about.
const MEASURED_CLIPS: usize = 300;

/// A checkpoint with the buffers that tuning it needs.
#[derive(Debug)]
pub struct Tuner<'a> {
    /// What is being tuned; its weights stay float.
    pub checkpoint: Checkpoint,
    /// What the last step, or the last measurement, measured against the float model.
    pub report: StepReport,
    teacher: &'a FloatModel,
    device: Device,
    /// The weights as a blob of the present checkpoint would hold them.
    effective: FloatModel,
    /// Clips without their poses.
    dataset: Dataset,
    batch: Batch,
    student_workspace: Workspace,
    teacher_workspace: Workspace,
    /// As the device stores them. // (clip of the batch, β then α)
    codes: Vec<f32>,
    /// As the device stores them. // (moment, sinusoid)
    tau: Vec<f32>,
    /// Weight of each channel's mean squared error in the loss; 0 for constants. // (channel)
    channel_weights: Vec<f32>,
}

impl<'a> Tuner<'a> {
    /// Allocates every buffer; the effective weights are those of the checkpoint.
    pub fn new(checkpoint: Checkpoint, teacher: &'a FloatModel, device: Device) -> Self {
        let dataset = without_poses(&checkpoint.dataset);
        let batch = Batch::new(&dataset, &checkpoint.config, &checkpoint.model);
        let mut student_workspace = batch.workspace(teacher);
        student_workspace.round_activations(device.grids());
        Self {
            report: StepReport::default(),
            teacher,
            effective: device.effective_model(&checkpoint.model, &checkpoint.dataset),
            device,
            student_workspace,
            teacher_workspace: batch.workspace(teacher),
            batch,
            codes: Vec::new(),
            tau: Vec::new(),
            channel_weights: moving_channel_weights(&checkpoint),
            dataset,
            checkpoint,
        }
    }

    /// Does one step; fills `report`.
    pub fn step(&mut self, seed: u64, step: u64, learning_rate: f64) {
        let Checkpoint { config, sequence_codes, action_codes, .. } = &self.checkpoint;
        let config = TrainConfig { seed, ..config.clone() };
        self.batch.draw(&self.dataset, &config, [sequence_codes, action_codes], step);
        self.round_inputs();
        let rows = self.batch.rows();
        let rounded = Rows { codes: &self.codes, tau: &self.tau, ..rows };
        self.teacher.forward(&rows, &mut self.teacher_workspace);
        self.effective.forward(&rounded, &mut self.student_workspace);
        let weights = &self.channel_weights;
        compare(&mut self.student_workspace, &self.teacher_workspace, weights, &mut self.report);
        let Checkpoint { model, optimizer, .. } = &mut self.checkpoint;
        let wanted = Wanted {
            decoder: Some(&mut optimizer.decoder_gradient),
            accumulate: Accum::Replace,
            codes: None,
        };
        self.effective.backward(&rounded, &mut self.student_workspace, wanted);
        Adam::new(&config.adam).step_decoder(
            model.trained_layers_mut(),
            &optimizer.decoder_gradient,
            &mut optimizer.decoder,
            learning_rate,
            1.0,
        );
        self.refresh();
    }

    /// Brings the effective weights up to date.
    fn refresh(&mut self) {
        let Checkpoint { model, dataset, .. } = &self.checkpoint;
        self.effective = self.device.effective_model(model, dataset);
    }

    /// The weights as a blob of the checkpoint would hold them.
    pub fn effective_model(&self) -> &FloatModel {
        &self.effective
    }

    fn round_inputs(&mut self) {
        let rows = self.batch.rows();
        self.codes.clear();
        self.codes.extend_from_slice(rows.codes);
        self.device.round_codes(&mut self.codes);
        self.tau.resize(rows.tau.len(), 0.0);
        let sinusoid_count = self.teacher.sinusoid_count();
        for (tau, &frame) in self.tau.chunks_exact_mut(sinusoid_count).zip(self.batch.moments()) {
            self.device.embed_time(frame, tau);
        }
    }

    /// Fills `report` with the error of clips' mean codes, at frames evenly spaced over each.
    pub fn measure(&mut self) {
        let mut student = Workspace::new(self.teacher, 1, MEASURED_FRAMES, MEASURED_FRAMES);
        let mut teacher = student.clone();
        student.round_activations(self.device.grids());
        let mut total = StepReport::default();
        let clip_count = self.dataset.description.clips.len();
        for clip in (0..clip_count).step_by(clip_count.div_ceil(MEASURED_CLIPS)) {
            self.decode_clip(clip, [&mut student, &mut teacher]);
            compare(&mut student, &teacher, &self.channel_weights, &mut self.report);
            total.add(&self.report);
        }
        self.report = total;
    }

    fn decode_clip(&self, clip: usize, workspaces: [&mut Workspace; 2]) {
        let last = self.dataset.description.clips[clip].frame_count - 1;
        let frames: Vec<usize> =
            (0..MEASURED_FRAMES).map(|index| last * index / (MEASURED_FRAMES - 1)).collect();
        self.decode_frames(&self.checkpoint.mean_code(clip), &frames, workspaces);
    }

    /// Leaves poses in the workspaces: of the device, of the float model.
    fn decode_frames(&self, code: &[f32], frames: &[usize], workspaces: [&mut Workspace; 2]) {
        let [student, teacher] = workspaces;
        let sinusoid_count = self.teacher.sinusoid_count();
        let mut exact = vec![0.0; frames.len() * sinusoid_count];
        let mut stored = exact.clone();
        let rows = exact.chunks_exact_mut(sinusoid_count);
        for ((exact, stored), &frame) in
            rows.zip(stored.chunks_exact_mut(sinusoid_count)).zip(frames)
        {
            self.teacher.embed_time(frame as f64, exact);
            self.device.embed_time(frame, stored);
        }
        let mut rounded = code.to_vec();
        self.device.round_codes(&mut rounded);
        let rows = Rows {
            codes: code,
            tau: &exact,
            code_of_row: &vec![0; frames.len()],
            moment_of_row: &Vec::from_iter(0..frames.len()),
        };
        self.teacher.forward(&rows, teacher);
        self.effective.forward(&Rows { codes: &rounded, tau: &stored, ..rows }, student);
    }

    /// Standardised poses of a code at one frame: of the device, of the float model.
    #[cfg(test)]
    pub fn decode(&self, code: &[f32], frame: usize) -> [Vec<f32>; 2] {
        let mut student = Workspace::new(self.teacher, 1, 1, 1);
        let mut teacher = student.clone();
        student.round_activations(self.device.grids());
        self.decode_frames(code, &[frame], [&mut student, &mut teacher]);
        [student, teacher].map(|workspace| workspace.outputs().flatten().copied().collect())
    }
}

/// Leaves the loss's gradient by the student's poses in its workspace, and the squared errors in `report`.
fn compare(student: &mut Workspace, teacher: &Workspace, weights: &[f32], report: &mut StepReport) {
    let row_count = teacher.outputs().count();
    *report =
        StepReport { squared_errors: vec![0.0; weights.len()], row_count, ..StepReport::default() };
    let slope = 2.0 / row_count as f32;
    for ((pose, delta), target) in student.outputs_and_deltas().zip(teacher.outputs()) {
        vectorized(|| {
            let channels = delta.iter_mut().zip(&mut report.squared_errors);
            let values = pose.iter().zip(target).zip(weights);
            for ((delta, squares), ((pose, target), weight)) in channels.zip(values) {
                let error = pose - target;
                *delta = error * weight * slope;
                *squares += f64::from(error * error);
            }
        });
    }
    let weighted = |(sum, weight): (&f64, &f32)| sum * f64::from(*weight);
    let sum: f64 = report.squared_errors.iter().zip(weights).map(weighted).sum();
    report.reconstruction = sum / row_count as f64;
}

/// The loss's weights, without channels that never move: their scale is too small for a gradient to mean anything.
fn moving_channel_weights(checkpoint: &Checkpoint) -> Vec<f32> {
    let Checkpoint { config, dataset, .. } = checkpoint;
    let weights = channel_weights(&dataset.layout, config.loss.reduction);
    let moving = |(channel, weight)| if dataset.is_constant(channel) { 0.0 } else { weight };
    weights.into_iter().enumerate().map(moving).collect()
}

/// A dataset to draw frames from.
fn without_poses(description: &DatasetDescription) -> Dataset {
    let starts = description.clips.iter().scan(0, |next, clip| {
        let start = *next;
        *next += clip.frame_count;
        Some(start)
    });
    Dataset { first_rows: starts.collect(), poses: Vec::new(), description: description.clone() }
}
