//! What a classifier learns from a few motions at once: the loss, and its gradient by every weight.
//!
//! In:  poses and the right action of each motion.
//! Out: the mean cross-entropy over the batch, and the gradient.
//!
//! Why here: a batch is cut into blocks that go forward and back on one thread each; their gradients are added in the
//! blocks' order, so that the result does not depend on the number of threads.

use rayon::prelude::*;

use super::backward::{LayerDeltas, dense_gradient};
use super::recurrent::LayerTrace;
use super::{Classifier, HiddenStart, frames_first};
use crate::float_model::DenseLayer;
use crate::float_model::forward::{matrix, matrix_mut, multiply};
use crate::simd;

/// Motions of a block; fixed, as the sums depend on it.
const MOTIONS_PER_BLOCK: usize = 16;

/// Buffers of a batch, and its gradient.
#[derive(Debug)]
pub struct Lesson {
    blocks: Vec<Block>,
}

/// Motions that go through the frames together.
#[derive(Clone, Debug)]
struct Block {
    traces: Vec<LayerTrace>,
    deltas: Vec<LayerDeltas>,
    gradient: Vec<DenseLayer>,
    loss: f64,
}

impl Lesson {
    /// Buffers for batches of up to `motion_count` motions.
    pub fn new(classifier: &Classifier, motion_count: usize) -> Self {
        let block = Block {
            traces: vec![LayerTrace::default(); classifier.recurrent_count()],
            deltas: vec![LayerDeltas::default(); classifier.recurrent_count()],
            gradient: classifier.layers.iter().map(DenseLayer::zeros_like).collect(),
            loss: 0.0,
        };
        Self { blocks: vec![block; motion_count.div_ceil(MOTIONS_PER_BLOCK)] }
    }

    /// Takes a batch forward and back: its mean cross-entropy, whose gradient is then [`Lesson::gradient`].
    ///
    /// # Shapes
    /// `motions` (motion, frame, channel) · `actions` (motion)
    pub fn learn(&mut self, classifier: &Classifier, motions: &[f32], actions: &[usize]) -> f64 {
        let len = motions.len() / actions.len();
        let share = 1.0 / actions.len() as f32;
        let block_count = actions.len().div_ceil(MOTIONS_PER_BLOCK);
        self.blocks[..block_count]
            .par_iter_mut()
            .zip(motions.par_chunks(MOTIONS_PER_BLOCK * len))
            .zip(actions.par_chunks(MOTIONS_PER_BLOCK))
            .for_each(|((block, motions), actions)| {
                let frame_count = len / classifier.channel_count();
                let poses = frames_first(motions, frame_count, len);
                block.learn(classifier, &poses, actions, share);
            });
        let (first, others) = self.blocks[..block_count].split_at_mut(1);
        for block in others {
            first[0].loss += block.loss;
            for (sum, layer) in first[0].gradient.iter_mut().zip(&block.gradient) {
                simd::add(&mut sum.weights, &layer.weights);
                simd::add(&mut sum.bias, &layer.bias);
            }
        }
        first[0].loss
    }

    /// Of the last batch. // (layer)
    pub fn gradient(&self) -> &[DenseLayer] {
        &self.blocks[0].gradient
    }
}

impl Block {
    /// Forward and back; every motion counts `share` of the loss.
    ///
    /// # Shapes
    /// `poses` (frame, motion, channel) · `actions` (motion)
    fn learn(&mut self, classifier: &Classifier, poses: &[f32], actions: &[usize], share: f32) {
        let motion_count = actions.len();
        let mut features = vec![0.0; motion_count * classifier.feature_count()];
        let mut logits = vec![0.0; motion_count * classifier.action_count()];
        let starts = classifier.hidden_starts(HiddenStart::Zeros, 0, motion_count);
        classifier.score_block(poses, &starts, &mut self.traces);
        classifier.conclude(&self.traces, &mut features, &mut logits);
        self.loss = cross_entropy(&mut logits, actions, share);
        self.backward_ends(classifier, &features, &logits);
        for index in (0..self.traces.len()).rev() {
            let layer = classifier.recurrent(index);
            let (before, after) = self.deltas.split_at_mut(index);
            layer.backward(&self.traces[index], motion_count, &mut after[0]);
            let inputs = match before.last_mut() {
                Some(below) => {
                    let state_len = motion_count * layer.input.input_count;
                    below.states.resize(self.traces[index - 1].hidden.len(), 0.0);
                    below.states[..state_len].fill(0.0);
                    layer.input_gradient(&after[0], &mut below.states[state_len..]);
                    &self.traces[index - 1].hidden[state_len..]
                }
                None => poses,
            };
            let halves = &mut self.gradient[2 * index..][..2];
            after[0].weight_gradients(inputs, &self.traces[index], halves);
        }
    }

    /// From the gradient by the logits to that by the last state, which is left in the last layer's deltas.
    fn backward_ends(&mut self, classifier: &Classifier, features: &[f32], by_logits: &[f32]) {
        let [.., feature_layer, logit_layer] = &classifier.layers[..] else {
            unreachable!("a classifier ends in two layers");
        };
        let [.., by_feature_layer, by_logit_layer] = &mut self.gradient[..] else {
            unreachable!("the gradient has the classifier's layers");
        };
        dense_gradient(by_logits, features, by_logit_layer);
        let mut by_features = vec![0.0; features.len()];
        transposed(logit_layer, by_logits, &mut by_features);
        for (delta, feature) in by_features.iter_mut().zip(features) {
            *delta *= 1.0 - feature * feature;
        }
        let (Some(trace), Some(deltas)) = (self.traces.last(), self.deltas.last_mut()) else {
            unreachable!("a classifier has a recurrent layer");
        };
        let motion_count = features.len() / feature_layer.output_count;
        let last = trace.hidden.len() - motion_count * feature_layer.input_count;
        dense_gradient(&by_features, &trace.hidden[last..], by_feature_layer);
        deltas.states.clear();
        deltas.states.resize(trace.hidden.len(), 0.0);
        transposed(feature_layer, &by_features, &mut deltas.states[last..]);
    }
}

/// `inputs = deltas · weights`: the gradient by a layer's inputs.
fn transposed(layer: &DenseLayer, deltas: &[f32], inputs: &mut [f32]) {
    let target = matrix_mut(inputs, layer.input_count);
    let weights = matrix(&layer.weights, layer.input_count);
    multiply(target, faer::Accum::Replace, matrix(deltas, layer.output_count), weights);
}

/// `share` of the sum of −ln softmax of the right actions; turns the logits into their gradient.
fn cross_entropy(logits: &mut [f32], actions: &[usize], share: f32) -> f64 {
    let width = logits.len() / actions.len();
    let mut loss = 0.0;
    for (row, &action) in logits.chunks_exact_mut(width).zip(actions) {
        let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let right = row[action] - largest;
        row.iter_mut().for_each(|logit| *logit = (*logit - largest).exp());
        let sum: f32 = row.iter().sum();
        loss += f64::from(share * (sum.ln() - right));
        row.iter_mut().for_each(|power| *power *= share / sum);
        row[action] -= share;
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::specimen::{classifier, reference, values};

    const ACTIONS: [usize; 3] = [0, 2, 2];

    /// Slow, obvious and in f64.
    fn reference_loss(classifier: &Classifier, motions: &[f32]) -> f64 {
        let poses = motions.chunks(motions.len() / ACTIONS.len());
        let loss = |(poses, action): (&[f32], usize)| {
            let (_, logits) = reference(classifier, poses);
            logits.iter().map(|logit| logit.exp()).sum::<f64>().ln() - logits[action]
        };
        poses.zip(ACTIONS).map(loss).sum::<f64>() / ACTIONS.len() as f64
    }

    #[test]
    fn gradients_equal_finite_differences() {
        let classifier = classifier(4, 3);
        let motions = values(3 * 5 * 4);
        let mut lesson = Lesson::new(&classifier, 3);
        let loss = lesson.learn(&classifier, &motions, &ACTIONS);
        assert!((loss - reference_loss(&classifier, &motions)).abs() < 1e-6, "{loss}");
        let quotient = |place: &dyn Fn(&mut Classifier) -> &mut f32| {
            let (mut above, mut below) = (classifier.clone(), classifier.clone());
            *place(&mut above) += 1e-3;
            *place(&mut below) -= 1e-3;
            let step = f64::from(*place(&mut above)) - f64::from(*place(&mut below));
            (reference_loss(&above, &motions) - reference_loss(&below, &motions)) / step
        };
        let check = |analytic: f32, numeric: f64, what: &str| {
            let difference = (f64::from(analytic) - numeric).abs();
            assert!(difference < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} {numeric}");
        };
        for (index, layer) in lesson.gradient().iter().enumerate() {
            for (weight, slope) in layer.weights.iter().enumerate() {
                let numeric = quotient(&|c| &mut c.layers[index].weights[weight]);
                check(*slope, numeric, &format!("weight {weight} of layer {index}"));
            }
            for (unit, slope) in layer.bias.iter().enumerate() {
                let numeric = quotient(&|c| &mut c.layers[index].bias[unit]);
                check(*slope, numeric, &format!("bias {unit} of layer {index}"));
            }
        }
    }

    #[test]
    fn batch_of_many_blocks_is_the_mean_of_its_motions() {
        let classifier = classifier(4, 3);
        let motions = values(70 * 5 * 4);
        let actions: Vec<usize> = (0..70).map(|motion| motion % 3).collect();
        let mut lesson = Lesson::new(&classifier, 70);
        let loss = lesson.learn(&classifier, &motions, &actions);
        let whole = lesson.gradient().to_vec();
        let (mut loss_sum, mut bias_sum) = (0.0, 0.0);
        for (motion, action) in motions.chunks(5 * 4).zip(&actions) {
            loss_sum += lesson.learn(&classifier, motion, &[*action]);
            bias_sum += lesson.gradient()[0].bias[1];
        }
        assert!((loss - loss_sum / 70.0).abs() < 1e-5);
        assert!((whole[0].bias[1] - bias_sum / 70.0).abs() < 1e-6);
    }
}
