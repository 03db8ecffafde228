//! One training step: draw, forward, loss, backward, move.
//!
//! In:  the [`Checkpoint`] as it stands, the [`Dataset`], learning rates.
//! Out: the checkpoint one step later, and what the step measured.
//!
//! Source: Cervantes et al., ECCV 2022, equations 2 to 4, and the published code where the presets say so.

use faer::Accum;

use crate::checkpoint::Checkpoint;
use crate::config::{CodeComposition, CodeRows, DecoderStep, Reduction, TrainConfig};
use crate::dataset::Dataset;
use crate::float_model::tied_codes::tie_gradient;
use crate::float_model::{CodeTable, Wanted, Workspace};
use crate::layout::PoseLayout;
use crate::simd::vectorized;
use crate::train::batch::{Batch, StepPosition};
use crate::train::optimizer::{Adam, CodeMoments, clip_scale, sum_of_squares};

/// What a step measured, before it moved anything.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Weighted squared error.
    pub reconstruction: f64,
    /// Weighted KL of β plus that of α.
    pub divergence: f64,
    /// Sum over the rows of the squared standardised error. // (channel)
    pub squared_errors: Vec<f64>,
    /// Rows of the batch.
    pub row_count: usize,
    /// Distinct frames among them.
    pub moment_count: usize,
}

impl StepReport {
    /// Adds another batch to this one; both are of the same channels.
    pub fn add(&mut self, other: &Self) {
        let rows = (self.row_count + other.row_count) as f64;
        let share = other.row_count as f64 / rows;
        self.reconstruction += (other.reconstruction - self.reconstruction) * share;
        self.squared_errors.resize(other.squared_errors.len(), 0.0);
        for (sum, squares) in self.squared_errors.iter_mut().zip(&other.squared_errors) {
            *sum += squares;
        }
        self.row_count += other.row_count;
    }
}

/// The checkpoint with the buffers that training it needs.
#[derive(Debug)]
pub struct Trainer<'a> {
    /// What is being trained.
    pub checkpoint: Checkpoint,
    /// What the last step measured.
    pub report: StepReport,
    dataset: &'a Dataset,
    batch: Batch,
    workspace: Workspace,
    /// Weight of each channel's mean squared error in the loss. // (channel)
    channel_weights: Vec<f32>,
    /// Gradient by the codes as drawn. // (clip of the batch, β then α)
    drawn_gradient: Vec<f32>,
    sequence_gradient: CodeTable,
    action_gradient: CodeTable,
    /// Whether an action is in the batch. // (action)
    action_in_batch: Vec<bool>,
}

impl<'a> Trainer<'a> {
    /// Allocates every buffer; no step allocates afterwards.
    pub fn new(checkpoint: Checkpoint, dataset: &'a Dataset) -> Self {
        let batch = Batch::new(dataset, &checkpoint.config, &checkpoint.model);
        let layout = &dataset.description.layout;
        let clips_max =
            StepPosition::clips_max(dataset.description.clips.len(), &checkpoint.config);
        Self {
            report: StepReport {
                squared_errors: vec![0.0; layout.channel_count()],
                ..StepReport::default()
            },
            dataset,
            workspace: batch.workspace(&checkpoint.model),
            batch,
            channel_weights: channel_weights(layout, checkpoint.config.loss.reduction),
            drawn_gradient: vec![0.0; clips_max * checkpoint.model.code_count()],
            sequence_gradient: checkpoint.sequence_codes.zeros_like(),
            action_gradient: checkpoint.action_codes.zeros_like(),
            action_in_batch: vec![false; dataset.description.actions.len()],
            checkpoint,
        }
    }

    /// Does one step with the configured learning rates times `rate_factor`; fills `report`.
    pub fn step(&mut self, rate_factor: f64) {
        let position = self.draw();
        self.evaluate();
        self.differentiate(&position);
        self.collect_code_gradients();
        if position.moves_codes {
            if self.checkpoint.config.codes.action_code {
                self.move_action_codes(rate_factor);
            }
            self.move_sequence_codes(rate_factor);
        }
        if position.moves_decoder && self.decoder_is_due(&position) {
            self.move_decoder(rate_factor);
        }
        self.checkpoint.state.step += 1;
    }

    /// As [`step`](Self::step), but moves β alone: so the code of a clip is found that training did not see.
    pub fn step_sequence_codes(&mut self, rate_factor: f64) {
        let position = StepPosition { moves_codes: true, moves_decoder: false, ..self.draw() };
        self.evaluate();
        self.differentiate(&position);
        self.collect_code_gradients();
        self.move_sequence_codes(rate_factor);
        self.checkpoint.state.step += 1;
    }

    fn draw(&mut self) -> StepPosition {
        let Checkpoint { config, state, sequence_codes, action_codes, .. } = &self.checkpoint;
        self.batch.draw(self.dataset, config, [sequence_codes, action_codes], state.step)
    }

    /// Decodes the batch; leaves the loss's gradient by the poses in the workspace.
    fn evaluate(&mut self) {
        let Self { report, batch, workspace, channel_weights, .. } = self;
        self.checkpoint.model.forward(&batch.rows(), workspace);
        let row_count = batch.target_rows.len();
        (report.row_count, report.moment_count) = (row_count, batch.moment_count());
        report.squared_errors.fill(0.0);
        let slope = 2.0 / row_count as f32;
        for ((pose, delta), &row) in workspace.outputs_and_deltas().zip(&batch.target_rows) {
            let target = &self.dataset.poses[row * pose.len()..][..pose.len()];
            vectorized(|| {
                let channels = delta.iter_mut().zip(&mut report.squared_errors);
                let values = pose.iter().zip(target).zip(channel_weights.iter());
                for ((delta, squares), ((pose, target), weight)) in channels.zip(values) {
                    let error = pose - target;
                    *delta = error * weight * slope;
                    *squares += f64::from(error * error);
                }
            });
        }
        let weighted = |(sum, weight): (&f64, &f32)| sum * f64::from(*weight);
        let sum: f64 = report.squared_errors.iter().zip(&*channel_weights).map(weighted).sum();
        report.reconstruction = sum / row_count as f64;
    }

    /// The gradients that this step needs, and no others.
    fn differentiate(&mut self, position: &StepPosition) {
        let Checkpoint { model, optimizer, config, .. } = &mut self.checkpoint;
        let code_count = model.code_count();
        let drawn_gradient = &mut self.drawn_gradient[..self.batch.clips.len() * code_count];
        let sums = config.update.decoder_step == DecoderStep::Epoch && position.places.start > 0;
        let wanted = Wanted {
            decoder: position.moves_decoder.then_some(&mut optimizer.decoder_gradient[..]),
            accumulate: if sums { Accum::Add } else { Accum::Replace },
            codes: position.moves_codes.then_some(drawn_gradient),
        };
        model.backward(&self.batch.rows(), &mut self.workspace, wanted);
    }

    /// Turns the gradient by drawn codes into that by means and log-variances, and adds that of the KL terms.
    fn collect_code_gradients(&mut self) {
        let config = &self.checkpoint.config;
        self.action_gradient.mean.fill(0.0);
        self.action_gradient.log_variance.fill(0.0);
        if config.update.code_rows == CodeRows::Dense {
            self.sequence_gradient.mean.fill(0.0);
            self.sequence_gradient.log_variance.fill(0.0);
        }
        for &clip in &self.batch.clips {
            let range = clip * self.sequence_gradient.dimension_count..;
            let range = range.start..range.start + self.sequence_gradient.dimension_count;
            self.sequence_gradient.mean[range.clone()].fill(0.0);
            self.sequence_gradient.log_variance[range].fill(0.0);
        }
        let kl_weight = config.loss.kl_weight as f32 / self.batch.clips.len() as f32;
        let variational = config.codes.variational();
        let mut divergence = 0.0;
        let mut start = 0;
        for (&clip, &action) in self.batch.clips.iter().zip(&self.batch.actions) {
            for (table, gradient, row, variational) in [
                (
                    &self.checkpoint.sequence_codes,
                    &mut self.sequence_gradient,
                    clip,
                    variational[0],
                ),
                (&self.checkpoint.action_codes, &mut self.action_gradient, action, variational[1]),
            ] {
                let end = start + table.dimension_count;
                let drawn = DrawnCode {
                    gradient: &self.drawn_gradient[start..end],
                    noise: &self.batch.noise[start..end],
                    deviation: &self.batch.deviation[start..end],
                };
                let weight = if variational { kl_weight } else { 0.0 };
                divergence += drawn.add_gradient(table, row, weight, gradient);
                start = end;
            }
        }
        self.report.divergence = divergence;
    }

    fn move_action_codes(&mut self, rate_factor: f64) {
        let Checkpoint { config, action_codes, optimizer, .. } = &mut self.checkpoint;
        self.action_in_batch.fill(config.update.code_rows == CodeRows::Dense);
        for &action in &self.batch.actions {
            self.action_in_batch[action] = true;
        }
        let step = CodeStep::new(config, rate_factor);
        let in_batch = &self.action_in_batch;
        let actions = (0..in_batch.len()).filter(|&action| in_batch[action]);
        step.run(action_codes, &self.action_gradient, &mut optimizer.action_codes, actions);
    }

    fn move_sequence_codes(&mut self, rate_factor: f64) {
        let Checkpoint { config, sequence_codes, optimizer, .. } = &mut self.checkpoint;
        let step = CodeStep::new(config, rate_factor);
        let moments = &mut optimizer.sequence_codes;
        if config.update.code_rows == CodeRows::Dense {
            let rows = 0..sequence_codes.row_count();
            step.run(sequence_codes, &self.sequence_gradient, moments, rows);
        } else {
            let rows = self.batch.clips.iter().copied();
            step.run(sequence_codes, &self.sequence_gradient, moments, rows);
        }
    }

    fn decoder_is_due(&self, position: &StepPosition) -> bool {
        match self.checkpoint.config.update.decoder_step {
            DecoderStep::Batch => true,
            DecoderStep::Epoch => position.is_last,
        }
    }

    fn move_decoder(&mut self, rate_factor: f64) {
        let Checkpoint { config, model, optimizer, .. } = &mut self.checkpoint;
        if config.codes.compose == CodeComposition::Add {
            let (first, others) = optimizer.decoder_gradient.split_at_mut(1);
            // Layer 1 sees the code, and what follows the decoder's own layers.
            let by_code = first.iter_mut().chain(others.iter_mut().skip(model.layers.len() - 1));
            by_code.for_each(|layer| tie_gradient(layer, model.sequence_code_count));
        }
        let norm_max = config.update.gradient_norm_max;
        let gradient_scale = if norm_max > 0.0 {
            let squares = optimizer
                .decoder_gradient
                .iter()
                .map(|layer| sum_of_squares(&layer.weights) + sum_of_squares(&layer.bias));
            clip_scale(squares.sum::<f64>().sqrt(), norm_max)
        } else {
            1.0
        };
        Adam::new(&config.adam).step_decoder(
            model.trained_layers_mut(),
            &optimizer.decoder_gradient,
            &mut optimizer.decoder,
            config.adam.decoder_learning_rate * rate_factor,
            gradient_scale,
        );
    }
}

/// β or α of one clip of the batch, as drawn. // (dimension) each
struct DrawnCode<'a> {
    gradient: &'a [f32],
    noise: &'a [f32],
    deviation: &'a [f32],
}

impl DrawnCode<'_> {
    /// Adds the gradient by mean and log-variance to the table's; returns the weighted KL to N(0, I).
    ///
    /// # Source
    /// z = μ + σε gives ∂z/∂μ = 1 and ∂z/∂log σ² = ½σε; KL = ½ Σ (μ² + σ² − 1 − log σ²).
    fn add_gradient(
        &self,
        table: &CodeTable,
        row: usize,
        kl_weight: f32,
        gradient: &mut CodeTable,
    ) -> f64 {
        let start = row * table.dimension_count;
        let mut divergence = 0.0;
        for dimension in 0..table.dimension_count {
            let by_code = self.gradient[dimension];
            let mean = table.mean[start + dimension];
            let log_variance = table.log_variance[start + dimension];
            let variance = self.deviation[dimension] * self.deviation[dimension];
            gradient.mean[start + dimension] += by_code + kl_weight * mean;
            gradient.log_variance[start + dimension] +=
                0.5 * by_code * self.noise[dimension] + 0.5 * kl_weight * (variance - 1.0);
            divergence += f64::from(mean * mean + variance - 1.0 - log_variance);
        }
        0.5 * f64::from(kl_weight) * divergence
    }
}

/// One optimiser step over rows of a code table.
struct CodeStep {
    adam: Adam,
    learning_rate: f64,
    norm_max: f64,
}

impl CodeStep {
    fn new(config: &TrainConfig, rate_factor: f64) -> Self {
        Self {
            adam: Adam::new(&config.adam),
            learning_rate: config.adam.code_learning_rate * rate_factor,
            norm_max: config.update.gradient_norm_max,
        }
    }

    fn run(
        &self,
        table: &mut CodeTable,
        gradient: &CodeTable,
        moments: &mut CodeMoments,
        rows: impl Iterator<Item = usize> + Clone,
    ) {
        let squares = |row| {
            sum_of_squares(gradient.mean_of(row)) + sum_of_squares(gradient.log_variance_of(row))
        };
        let scale = if self.norm_max > 0.0 {
            clip_scale(rows.clone().map(squares).sum::<f64>().sqrt(), self.norm_max)
        } else {
            1.0
        };
        for row in rows {
            self.adam.step_code(table, gradient, moments, row, self.learning_rate, scale);
        }
    }
}

/// Weight of each channel's mean squared error, so that their sum is the loss. // (channel)
pub fn channel_weights(layout: &PoseLayout, reduction: Reduction) -> Vec<f32> {
    let channel_count_of = |kind| {
        let of_kind = layout.groups.iter().filter(|group| group.kind == kind);
        of_kind.map(|group| group.kind.channel_count()).sum::<usize>()
    };
    let weight = |kind| match reduction {
        Reduction::Channel => 1.0 / layout.channel_count() as f32,
        Reduction::Kind => 1.0 / channel_count_of(kind) as f32,
    };
    let group_weights =
        |group: &crate::layout::Group| vec![weight(group.kind); group.kind.channel_count()];
    layout.groups.iter().flat_map(group_weights).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float_model::DenseLayer;
    use crate::train::synthetic::{config, dataset};

    #[test]
    fn mean_and_log_variance_gradients_equal_f64_finite_differences() {
        const EPSILON: f64 = -0.8;
        const BY_CODE: f64 = 0.37;
        const KL_WEIGHT: f64 = 0.2;
        let loss = |mean: f64, log_variance: f64| {
            let variance = log_variance.exp();
            let divergence = 0.5 * (mean * mean + variance - 1.0 - log_variance);
            BY_CODE * (mean + variance.sqrt() * EPSILON) + KL_WEIGHT * divergence
        };
        let (mean, log_variance) = (0.6_f32, -1.3_f32);
        let table =
            CodeTable { dimension_count: 1, mean: vec![mean], log_variance: vec![log_variance] };
        let deviation = (0.5 * log_variance).exp();
        let drawn = DrawnCode {
            gradient: &[BY_CODE as f32],
            noise: &[deviation * EPSILON as f32],
            deviation: &[deviation],
        };
        let mut gradient = table.zeros_like();
        let divergence = drawn.add_gradient(&table, 0, KL_WEIGHT as f32, &mut gradient);
        let (mean, log_variance) = (f64::from(mean), f64::from(log_variance));
        let by_mean = (loss(mean + 1e-5, log_variance) - loss(mean - 1e-5, log_variance)) / 2e-5;
        let by_log = (loss(mean, log_variance + 1e-5) - loss(mean, log_variance - 1e-5)) / 2e-5;
        assert!((f64::from(gradient.mean[0]) - by_mean).abs() < 1e-6);
        assert!((f64::from(gradient.log_variance[0]) - by_log).abs() < 1e-6);
        let code_part = BY_CODE * (mean + f64::from(drawn.noise[0]));
        assert!((divergence - (loss(mean, log_variance) - code_part)).abs() < 1e-6);
    }

    /// The loss at step 0, with every parameter moved by the caller and the same random numbers every time.
    fn loss_of(dataset: &Dataset, checkpoint: &Checkpoint) -> f64 {
        let mut trainer = Trainer::new(checkpoint.clone(), dataset);
        trainer.draw();
        trainer.evaluate();
        trainer.collect_code_gradients();
        trainer.report.reconstruction + trainer.report.divergence
    }

    /// Layers, then what codes do beyond layer 1.
    fn trained(checkpoint: &mut Checkpoint, index: usize) -> &mut DenseLayer {
        checkpoint.model.trained_layers_mut().nth(index).unwrap()
    }

    #[test]
    fn gradient_of_the_whole_step_equals_finite_differences() {
        const STEP: f32 = 4e-3;
        for variant in ["", "[loss]\nreduction = 'kind'\nkl_weight = 0.01"] {
            let (dataset, config) = (dataset(), config(variant));
            let mut checkpoint = Checkpoint::start(&dataset, &config);
            for (index, mean) in checkpoint.sequence_codes.mean.iter_mut().enumerate() {
                *mean = (index as f32).sin();
            }
            let mut trainer = Trainer::new(checkpoint.clone(), &dataset);
            let position = trainer.draw();
            trainer.evaluate();
            trainer.differentiate(&position);
            trainer.collect_code_gradients();
            let check = |analytic: f32, place: &dyn Fn(&mut Checkpoint) -> &mut f32| {
                let (mut above, mut below) = (checkpoint.clone(), checkpoint.clone());
                *place(&mut above) += STEP;
                *place(&mut below) -= STEP;
                let rise = loss_of(&dataset, &above) - loss_of(&dataset, &below);
                let numeric = rise / f64::from(2.0 * STEP);
                let difference = (numeric - f64::from(analytic)).abs();
                assert!(difference < 1e-3 * numeric.abs() + 3e-5, "{variant} {analytic} {numeric}");
            };
            for place in 0..checkpoint.sequence_codes.mean.len() {
                let gradient = &trainer.sequence_gradient;
                check(gradient.mean[place], &|c| &mut c.sequence_codes.mean[place]);
                check(gradient.log_variance[place], &|c| &mut c.sequence_codes.log_variance[place]);
            }
            for place in 0..checkpoint.action_codes.mean.len() {
                let gradient = &trainer.action_gradient;
                check(gradient.mean[place], &|c| &mut c.action_codes.mean[place]);
                check(gradient.log_variance[place], &|c| &mut c.action_codes.log_variance[place]);
            }
            let gradient = trainer.checkpoint.optimizer.decoder_gradient.clone();
            for (layer, gradient) in gradient.iter().enumerate() {
                check(gradient.bias[1], &|c| &mut trained(c, layer).bias[1]);
                for place in (0..gradient.weights.len()).step_by(7) {
                    check(gradient.weights[place], &|c| &mut trained(c, layer).weights[place]);
                }
            }
        }
    }

    #[test]
    fn added_codes_keep_their_halves_alike_and_learn_by_the_sum_of_both_gradients() {
        const STEP: f32 = 4e-3;
        let (dataset, config) =
            (dataset(), config("[codes]\ncompose = 'add'\naction_dimensions = 4"));
        let mut checkpoint = Checkpoint::start(&dataset, &config);
        let values = checkpoint.sequence_codes.mean.iter_mut();
        values.enumerate().for_each(|(index, mean)| *mean = (index as f32).sin());
        checkpoint.action_codes.mean.fill(0.5);
        let mut trainer = Trainer::new(checkpoint.clone(), &dataset);
        trainer.step(1.0);
        let first = &trainer.checkpoint.model.layers[0];
        for row in first.weights.chunks_exact(first.input_count) {
            assert_eq!(row[..4], row[4..8]);
        }
        assert_ne!(*first, checkpoint.model.layers[0]);
        let gradient = &trainer.checkpoint.optimizer.decoder_gradient[0];
        for place in (0..gradient.weights.len()).filter(|place| place % 16 < 4) {
            let moved = |step: f32| {
                let mut moved = checkpoint.clone();
                moved.model.layers[0].weights[place] += step;
                moved.model.layers[0].weights[place + 4] += step;
                loss_of(&dataset, &moved)
            };
            let numeric = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
            let difference = (numeric - f64::from(gradient.weights[place])).abs();
            assert!(difference < 1e-3 * numeric.abs() + 3e-5, "{numeric} {place}");
        }
    }

    #[test]
    fn actions_without_a_code_stay_at_zero_and_draw_no_noise() {
        let (dataset, config) = (dataset(), config("[codes]\naction_code = false"));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        let start = trainer.checkpoint.action_codes.clone();
        (0..5).for_each(|_| trainer.step(1.0));
        assert_eq!(trainer.checkpoint.action_codes, start);
        assert!(start.mean.iter().all(|mean| *mean == 0.0));
        assert!(trainer.batch.rows().codes.chunks_exact(7).all(|code| code[4..] == [0.0; 3]));
        let first = &trainer.checkpoint.model.layers[0];
        let rows = first.weights.chunks_exact(first.input_count);
        assert!(rows.into_iter().all(|row| row[4..7] == [0.0; 3]));
    }

    #[test]
    fn kinds_weigh_the_same_whatever_their_number_of_channels() {
        let weights = channel_weights(&dataset().description.layout, Reduction::Kind);
        assert_eq!(weights, [1.0 / 3.0; 6]);
        let weights = channel_weights(&dataset().description.layout, Reduction::Channel);
        assert_eq!(weights, [1.0 / 6.0; 6]);
    }

    #[test]
    fn alternating_passes_move_codes_then_weights() {
        let (dataset, config) = (dataset(), config("[update]\norder = 'alternate'"));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        let start = trainer.checkpoint.clone();
        (0..3).for_each(|_| trainer.step(1.0));
        assert_eq!(trainer.checkpoint.model, start.model);
        assert_ne!(trainer.checkpoint.sequence_codes, start.sequence_codes);
        let codes = trainer.checkpoint.sequence_codes.clone();
        (0..3).for_each(|_| trainer.step(1.0));
        assert_ne!(trainer.checkpoint.model, start.model);
        assert_eq!(trainer.checkpoint.sequence_codes, codes);
    }

    #[test]
    fn summed_gradient_moves_weights_once_a_pass() {
        let (dataset, config) = (dataset(), config("[update]\ndecoder_step = 'epoch'"));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        let start = trainer.checkpoint.model.clone();
        (0..2).for_each(|_| trainer.step(1.0));
        assert_eq!(trainer.checkpoint.model, start);
        trainer.step(1.0);
        assert_ne!(trainer.checkpoint.model, start);
        assert_eq!(trainer.checkpoint.optimizer.decoder.step_count, 1);
    }
}
