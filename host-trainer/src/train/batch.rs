//! Choosing what a step sees: clips, frames, noise.
//!
//! In:  the dataset's lengths, the configuration, the step's index.
//! Out: a [`Batch`] whose rows the decoder evaluates.
//!
//! Why here: everything is a function of (seed, step), so a resumed run draws what the uninterrupted one would have.
//!
//! Source: notes on the published code: frames without replacement; a clip shorter than the wanted number repeats its
//! last pose while time runs on; order and noise are new in every pass.

use core::ops::Range;

use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use crate::config::{BatchConfig, FrameSampling, TrainConfig, UpdateOrder};
use crate::dataset::Dataset;
use crate::float_model::{CodeTable, FloatModel, Rows, Workspace};
use crate::random::{Purpose, stream};

/// One batch; all buffers are allocated once.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Index of each clip. // (clip of the batch)
    pub clips: Vec<usize>,
    /// Index of each clip's action. // (clip of the batch)
    pub actions: Vec<usize>,
    /// Standard deviation of β then α; 0 where the table is not variational. // (clip of the batch, dimension)
    pub deviation: Vec<f32>,
    /// Deviation times a standard normal number: what was added to the mean. // (clip of the batch, dimension)
    pub noise: Vec<f32>,
    /// Row of each target pose in the dataset. // (row)
    pub target_rows: Vec<usize>,
    codes: Vec<f32>,
    code_count: usize,
    tau: Vec<f32>,
    sinusoid_count: usize,
    code_of_row: Vec<usize>,
    moment_of_row: Vec<usize>,
    /// The frames that occur, each once. // (moment)
    moments: Vec<usize>,
    /// Index into `moments`, for the frames that occur. // (frame)
    moment_of_frame: Vec<Option<usize>>,
    /// τ of every frame of the longest clip. // (frame, sinusoid)
    tau_of_frame: Vec<f32>,
    /// Clips in the order of this pass, and the pass that it belongs to.
    clip_order: Vec<usize>,
    order_of_pass: Option<u64>,
    /// Most codes, moments and rows of a batch.
    workspace_size: (usize, usize, usize),
}

/// Where a step stands in the course of the passes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepPosition {
    /// Passes over all clips before this one.
    pub pass: u64,
    /// Places of the pass's clip order that form the batch.
    pub places: Range<usize>,
    /// Whether the batch is the last of its pass.
    pub is_last: bool,
    /// Whether the step moves codes.
    pub moves_codes: bool,
    /// Whether the step moves weights, or adds to their gradient.
    pub moves_decoder: bool,
}

impl StepPosition {
    /// The position of a step; a pass is cut into batches of equal size, as far as that is possible.
    pub fn of_step(step: u64, clip_count: usize, config: &TrainConfig) -> Self {
        let batch_count = Self::batch_count(clip_count, config);
        let (pass, batch) = (step / batch_count as u64, (step % batch_count as u64) as usize);
        let joint = config.update.order == UpdateOrder::Joint;
        Self {
            pass,
            places: batch * clip_count / batch_count..(batch + 1) * clip_count / batch_count,
            is_last: batch + 1 == batch_count,
            moves_codes: joint || pass.is_multiple_of(2),
            moves_decoder: joint || !pass.is_multiple_of(2),
        }
    }

    /// Batches of a pass.
    pub fn batch_count(clip_count: usize, config: &TrainConfig) -> usize {
        clip_count.div_ceil(config.batch.clips)
    }

    /// Clips of the largest batch.
    pub fn clips_max(clip_count: usize, config: &TrainConfig) -> usize {
        clip_count.div_ceil(Self::batch_count(clip_count, config))
    }
}

impl Batch {
    /// Buffers for the largest batch of this dataset.
    pub fn new(dataset: &Dataset, config: &TrainConfig, model: &FloatModel) -> Self {
        let clips = &dataset.description.clips;
        let clips_max = StepPosition::clips_max(clips.len(), config);
        let longest = clips.iter().map(|clip| clip.frame_count).max().unwrap_or(0);
        let frame_count = longest.max(config.batch.frames);
        let (code_count, sinusoid_count) = (model.code_count(), model.sinusoid_count());
        let mut tau_of_frame = vec![0.0; frame_count * sinusoid_count];
        for (frame, tau) in tau_of_frame.chunks_exact_mut(sinusoid_count).enumerate() {
            model.embed_time(frame as f64, tau);
        }
        let rows_max = clips_max * config.batch.frames;
        let moments_max = frame_count.min(rows_max);
        Self {
            clips: Vec::with_capacity(clips_max),
            actions: Vec::with_capacity(clips_max),
            deviation: vec![0.0; clips_max * code_count],
            noise: vec![0.0; clips_max * code_count],
            codes: vec![0.0; clips_max * code_count],
            code_count,
            sinusoid_count,
            target_rows: Vec::with_capacity(rows_max),
            code_of_row: Vec::with_capacity(rows_max),
            moment_of_row: Vec::with_capacity(rows_max),
            tau: Vec::with_capacity(moments_max * sinusoid_count),
            moment_of_frame: vec![None; frame_count],
            moments: Vec::with_capacity(moments_max),
            tau_of_frame,
            clip_order: (0..clips.len()).collect(),
            order_of_pass: None,
            workspace_size: (clips_max, moments_max, rows_max),
        }
    }

    /// The buffers for evaluating the largest batch.
    pub fn workspace(&self, model: &FloatModel) -> Workspace {
        let (codes_max, moments_max, rows_max) = self.workspace_size;
        Workspace::new(model, codes_max, moments_max, rows_max)
    }

    /// Distinct frames of the batch.
    pub fn moment_count(&self) -> usize {
        self.moments.len()
    }

    /// The frames that occur, each once. // (moment)
    pub fn moments(&self) -> &[usize] {
        &self.moments
    }

    /// What the decoder has to evaluate.
    pub fn rows(&self) -> Rows<'_> {
        Rows {
            codes: &self.codes[..self.clips.len() * self.code_count],
            tau: &self.tau,
            code_of_row: &self.code_of_row,
            moment_of_row: &self.moment_of_row,
        }
    }

    /// Draws the batch of a step.
    pub fn draw(
        &mut self,
        dataset: &Dataset,
        config: &TrainConfig,
        tables: [&CodeTable; 2],
        step: u64,
    ) -> StepPosition {
        let descriptions = &dataset.description.clips;
        let position = StepPosition::of_step(step, descriptions.len(), config);
        self.order_clips(config.seed, position.pass);
        self.clips.clear();
        self.clips.extend_from_slice(&self.clip_order[position.places.clone()]);
        self.actions.clear();
        self.actions.extend(self.clips.iter().map(|&clip| descriptions[clip].action));
        let mut rng = stream(config.seed, Purpose::Step, step);
        self.draw_frames(dataset, &config.batch, &mut rng);
        self.draw_codes(config, tables, &mut rng);
        position
    }

    fn order_clips(&mut self, seed: u64, pass: u64) {
        if self.order_of_pass == Some(pass) {
            return;
        }
        for (place, clip) in self.clip_order.iter_mut().enumerate() {
            *clip = place;
        }
        self.clip_order.shuffle(&mut stream(seed, Purpose::ClipOrder, pass));
        self.order_of_pass = Some(pass);
    }

    fn draw_frames(&mut self, dataset: &Dataset, config: &BatchConfig, rng: &mut impl Rng) {
        for moment in self.moments.drain(..) {
            self.moment_of_frame[moment] = None;
        }
        self.tau.clear();
        self.target_rows.clear();
        self.code_of_row.clear();
        self.moment_of_row.clear();
        match config.sampling {
            FrameSampling::Random => self.draw_random(dataset, config.frames, rng),
            FrameSampling::Spread => self.draw_spread(dataset, config.frames, rng),
        }
    }

    /// Any frames of a clip, none twice.
    fn draw_random(&mut self, dataset: &Dataset, frames_per_clip: usize, rng: &mut impl Rng) {
        for index in 0..self.clips.len() {
            let frame_count = dataset.description.clips[self.clips[index]].frame_count;
            let first_row = self.target_rows.len();
            for place in 0..frames_per_clip {
                let frame = if frame_count <= frames_per_clip {
                    place
                } else {
                    self.unused_frame(frame_count - frames_per_clip + place, first_row, rng)
                };
                self.push_row(dataset, index, frame);
            }
        }
    }

    /// One frame from each of as many equal parts of a clip.
    fn draw_spread(&mut self, dataset: &Dataset, part_count: usize, rng: &mut impl Rng) {
        for index in 0..self.clips.len() {
            let frame_count = dataset.description.clips[self.clips[index]].frame_count;
            for part in 0..part_count {
                let place = (part as f64 + rng.random::<f64>()) / part_count as f64;
                let frame = (place * frame_count as f64) as usize;
                self.push_row(dataset, index, frame.min(frame_count - 1));
            }
        }
    }

    /// Adds a frame of a clip of the batch; after the clip's end its last pose is the target.
    fn push_row(&mut self, dataset: &Dataset, index: usize, frame: usize) {
        let clip = self.clips[index];
        let pose = frame.min(dataset.description.clips[clip].frame_count - 1);
        self.target_rows.push(dataset.first_rows[clip] + pose);
        self.code_of_row.push(index);
        let moment = self.moment_of(frame);
        self.moment_of_row.push(moment);
    }

    /// A frame in 0..=`last` that the clip has not got yet; `last` itself when the draw is taken.
    ///
    /// # Source
    /// Floyd's algorithm (Bentley, CACM 1987): with `last` running over the final frames, every subset is equally
    /// likely.
    fn unused_frame(&self, last: usize, first_row: usize, rng: &mut impl Rng) -> usize {
        let frame = rng.random_range(0..=last);
        let taken = self.moment_of_row[first_row..].iter().any(|&m| self.moments[m] == frame);
        if taken { last } else { frame }
    }

    /// The row of `tau` that holds this frame, made on first use.
    fn moment_of(&mut self, frame: usize) -> usize {
        *self.moment_of_frame[frame].get_or_insert_with(|| {
            let tau = &self.tau_of_frame[frame * self.sinusoid_count..][..self.sinusoid_count];
            self.tau.extend_from_slice(tau);
            self.moments.push(frame);
            self.moments.len() - 1
        })
    }

    /// z = μ + exp(½ log σ²) ε, for β and α, with fresh ε for every clip.
    fn draw_codes(&mut self, config: &TrainConfig, tables: [&CodeTable; 2], rng: &mut impl Rng) {
        let variational = config.codes.variational();
        for index in 0..self.clips.len() {
            let mut start = index * self.code_count;
            for (part, row) in [self.clips[index], self.actions[index]].into_iter().enumerate() {
                let (mean, log_variance) =
                    (tables[part].mean_of(row), tables[part].log_variance_of(row));
                let range = start..start + mean.len();
                start = range.end;
                let deviation = &mut self.deviation[range.clone()];
                let noise = &mut self.noise[range.clone()];
                let codes = &mut self.codes[range];
                for dimension in 0..mean.len() {
                    if variational[part] {
                        let epsilon: f32 = StandardNormal.sample(rng);
                        deviation[dimension] = (0.5 * log_variance[dimension]).exp();
                        noise[dimension] = deviation[dimension] * epsilon;
                    }
                    codes[dimension] = mean[dimension] + noise[dimension];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::Checkpoint;
    use crate::train::synthetic::{config, dataset};

    fn drawn(step: u64, overrides: &str) -> (Batch, StepPosition) {
        let (dataset, config) = (dataset(), config(overrides));
        let start = Checkpoint::start(&dataset, &config);
        let mut batch = Batch::new(&dataset, &config, &start.model);
        let tables = [&start.sequence_codes, &start.action_codes];
        // An earlier draw must leave no trace.
        batch.draw(&dataset, &config, tables, step + 5);
        let position = batch.draw(&dataset, &config, tables, step);
        (batch, position)
    }

    #[test]
    fn pass_holds_every_clip_once_in_batches_of_equal_size() {
        let batches: Vec<Vec<usize>> = (3..6).map(|step| drawn(step, "").0.clips).collect();
        let sizes: Vec<usize> = batches.iter().map(Vec::len).collect();
        assert_eq!(sizes, [1, 2, 2]);
        let mut clips = batches.concat();
        clips.sort_unstable();
        assert_eq!(clips, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn frames_of_a_clip_differ_and_lie_inside_it() {
        let dataset = dataset();
        for step in 0..200 {
            let (batch, _) = drawn(step, "");
            for (index, &clip) in batch.clips.iter().enumerate() {
                let rows = &batch.target_rows[5 * index..5 * index + 5];
                let first = dataset.first_rows[clip];
                let frame_count = dataset.description.clips[clip].frame_count;
                assert!(rows.iter().all(|row| (first..first + frame_count).contains(row)));
                let mut distinct = rows.to_vec();
                distinct.sort_unstable();
                distinct.dedup();
                assert_eq!(distinct.len(), frame_count.min(5));
            }
        }
    }

    #[test]
    fn short_clip_repeats_its_last_pose_while_time_runs_on() {
        let (batch, _) =
            (0..3).map(|step| drawn(step, "")).find(|(b, _)| b.clips.contains(&1)).unwrap();
        let index = batch.clips.iter().position(|&clip| clip == 1).unwrap();
        assert_eq!(batch.target_rows[5 * index..5 * index + 5], [12, 13, 14, 14, 14]);
        let frame = |row: usize| batch.moments[batch.moment_of_row[row]];
        let frames: Vec<usize> = (5 * index..5 * index + 5).map(frame).collect();
        assert_eq!(frames, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn every_frame_is_equally_likely() {
        let mut counts = [0_u32; 12];
        for step in 0..3000 {
            let (batch, _) = drawn(step, "[batch]\nclips = 5");
            let rows = batch.target_rows.iter();
            rows.filter(|row| **row < 12).for_each(|row| counts[*row] += 1);
        }
        let expected = 3000.0 * 5.0 / 12.0;
        assert!(
            counts.iter().all(|count| (f64::from(*count) / expected - 1.0).abs() < 0.1),
            "{counts:?}"
        );
    }

    #[test]
    fn spread_frames_come_one_from_each_part_and_equally_often() {
        for step in 0..50 {
            let (batch, _) = drawn(step, "[batch]\nsampling = 'spread'");
            let whole = batch.clips.iter().position(|&clip| clip == 2);
            let Some(index) = whole else { continue };
            let rows = &batch.target_rows[5 * index..5 * index + 5];
            let parts: Vec<usize> = rows.iter().map(|row| (row - 15) / 8).collect();
            assert_eq!(parts, [0, 1, 2, 3, 4]);
        }
        let mut found = [0.0_f64; 106];
        for step in 0..3000 {
            let (batch, _) = drawn(step, "[batch]\nclips = 5\nsampling = 'spread'");
            assert_eq!(batch.target_rows.len(), 25);
            batch.target_rows.iter().for_each(|&row| found[row] += 1.0 / 3000.0);
        }
        for (rows, frame_count) in [(0..12, 12.0), (12..15, 3.0), (15..55, 40.0), (76..106, 30.0)] {
            assert!(found[rows].iter().all(|share| (share * frame_count / 5.0 - 1.0).abs() < 0.2));
        }
    }

    #[test]
    fn code_is_its_mean_without_variation_and_mean_plus_noise_with_it() {
        let (batch, _) = drawn(0, "[codes]\nsequence_variational = false");
        assert_eq!(batch.codes[..4], [0.0; 4]);
        assert!(batch.codes[4..7].iter().all(|code| *code != 0.0));
    }
}
