//! Adam, for the decoder's layers and for the rows of the code tables.
//!
//! In:  gradients from `float_model::backward`; learning rates from `schedule`.
//! Out: moved parameters; the moments and counts go to `checkpoint`.
//!
//! Why here: moments have the shapes of what they belong to, so they are kept as [`DenseLayer`] and [`CodeTable`] too
//! and are stored under the same names.
//!
//! Source: Kingma and Ba 2015, algorithm 1; PyTorch's placement of epsilon outside the bias correction. A code row
//! counts its own steps, as one PyTorch parameter per code does.

use rayon::prelude::*;

use crate::config::AdamConfig;
use crate::float_model::{CodeTable, DenseLayer};
use crate::simd::vectorized;

/// Running moments of the decoder's gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderMoments {
    /// Mean of the gradient.
    pub first: Vec<DenseLayer>,
    /// Mean of its square.
    pub second: Vec<DenseLayer>,
    /// Steps taken.
    pub step_count: u32,
}

/// Running moments of a code table's gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct CodeMoments {
    /// Mean of the gradient.
    pub first: CodeTable,
    /// Mean of its square.
    pub second: CodeTable,
    /// Steps taken. // (row)
    pub step_counts: Vec<u32>,
}

/// What one step needs beyond gradient and moments.
#[derive(Clone, Copy, Debug)]
pub struct Adam {
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
}

/// One step's factors, which depend on the number of steps before it.
#[derive(Clone, Copy, Debug)]
struct StepFactors {
    adam: Adam,
    /// Learning rate / (1 − β1ⁿ).
    rate: f32,
    /// 1 / √(1 − β2ⁿ).
    root_scale: f32,
    /// Scale of the gradient; below 1 when it is clipped.
    gradient_scale: f32,
}

impl Adam {
    /// Takes the decays from the configuration.
    pub fn new(config: &AdamConfig) -> Self {
        Self {
            beta1: config.beta1 as f32,
            beta2: config.beta2 as f32,
            epsilon: config.epsilon as f32,
        }
    }

    /// Moves all layers by their gradient, scaled by `gradient_scale`.
    pub fn step_decoder<'l>(
        &self,
        layers: impl IntoIterator<Item = &'l mut DenseLayer>,
        gradient: &[DenseLayer],
        moments: &mut DecoderMoments,
        learning_rate: f64,
        gradient_scale: f32,
    ) {
        moments.step_count += 1;
        let factors = self.factors(moments.step_count, learning_rate, gradient_scale);
        for (((layer, gradient), first), second) in
            layers.into_iter().zip(gradient).zip(&mut moments.first).zip(&mut moments.second)
        {
            let (first_w, second_w) = (&mut first.weights, &mut second.weights);
            factors.step_parallel(&mut layer.weights, &gradient.weights, first_w, second_w);
            factors.step(&mut layer.bias, &gradient.bias, &mut first.bias, &mut second.bias);
        }
    }

    /// Moves one code by its gradient.
    pub fn step_code(
        &self,
        table: &mut CodeTable,
        gradient: &CodeTable,
        moments: &mut CodeMoments,
        row: usize,
        learning_rate: f64,
        gradient_scale: f32,
    ) {
        moments.step_counts[row] += 1;
        let factors = self.factors(moments.step_counts[row], learning_rate, gradient_scale);
        let range = row * table.dimension_count..(row + 1) * table.dimension_count;
        factors.step(
            &mut table.mean[range.clone()],
            &gradient.mean[range.clone()],
            &mut moments.first.mean[range.clone()],
            &mut moments.second.mean[range.clone()],
        );
        factors.step(
            &mut table.log_variance[range.clone()],
            &gradient.log_variance[range.clone()],
            &mut moments.first.log_variance[range.clone()],
            &mut moments.second.log_variance[range],
        );
    }

    fn factors(&self, step_count: u32, learning_rate: f64, gradient_scale: f32) -> StepFactors {
        let remaining = |decay: f32| 1.0 - f64::from(decay).powf(f64::from(step_count));
        StepFactors {
            adam: *self,
            rate: (learning_rate / remaining(self.beta1)) as f32,
            root_scale: (1.0 / remaining(self.beta2).sqrt()) as f32,
            gradient_scale,
        }
    }
}

impl StepFactors {
    fn step(&self, values: &mut [f32], gradient: &[f32], first: &mut [f32], second: &mut [f32]) {
        let Adam { beta1, beta2, epsilon } = self.adam;
        let StepFactors { rate, root_scale, gradient_scale, .. } = *self;
        vectorized(|| {
            let moments = first.iter_mut().zip(second);
            for ((value, gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments)
            {
                let gradient = gradient * gradient_scale;
                *first = beta1 * *first + (1.0 - beta1) * gradient;
                *second = beta2 * *second + (1.0 - beta2) * gradient * gradient;
                *value -= rate * *first / (second.sqrt() * root_scale + epsilon);
            }
        });
    }

    fn step_parallel(
        &self,
        values: &mut [f32],
        gradient: &[f32],
        first: &mut [f32],
        second: &mut [f32],
    ) {
        /// Large enough to be worth another thread, small enough to stay in its cache.
        const CHUNK: usize = 1 << 14;
        values
            .par_chunks_mut(CHUNK)
            .zip(gradient.par_chunks(CHUNK))
            .zip(first.par_chunks_mut(CHUNK))
            .zip(second.par_chunks_mut(CHUNK))
            .for_each(|(((values, gradient), first), second)| {
                self.step(values, gradient, first, second);
            });
    }
}

impl DecoderMoments {
    /// Before the first step.
    pub fn zeros<'l>(layers: impl IntoIterator<Item = &'l DenseLayer, IntoIter: Clone>) -> Self {
        let layers = layers.into_iter();
        let zeros = || layers.clone().map(DenseLayer::zeros_like).collect();
        Self { first: zeros(), second: zeros(), step_count: 0 }
    }
}

impl CodeMoments {
    /// Before the first step.
    pub fn zeros(table: &CodeTable) -> Self {
        Self {
            first: table.zeros_like(),
            second: table.zeros_like(),
            step_counts: vec![0; table.row_count()],
        }
    }
}

/// Factor that shortens a gradient of this Euclidean norm to at most `norm_max`; 1 when `norm_max` is 0.
pub fn clip_scale(norm: f64, norm_max: f64) -> f32 {
    /// Keeps the quotient finite; PyTorch's value.
    const NORM_FLOOR: f64 = 1e-6;
    if norm_max > 0.0 { (norm_max / (norm + NORM_FLOOR)).min(1.0) as f32 } else { 1.0 }
}

/// Sum of squares.
pub fn sum_of_squares(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value) * f64::from(*value)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADAM: Adam = Adam { beta1: 0.9, beta2: 0.999, epsilon: 1e-8 };

    #[test]
    fn clip_scale_shortens_long_gradients_only_and_only_when_on() {
        assert_eq!(clip_scale(100.0, 0.0), 1.0);
        assert_eq!(clip_scale(1.0, 2.0), 1.0);
        assert!((clip_scale(8.0, 2.0) - 0.25).abs() < 1e-6);
    }

    #[test]
    fn first_step_moves_by_the_learning_rate_against_the_gradient() {
        let mut layers = vec![DenseLayer::zeros(2, 1)];
        let mut gradient = layers.clone();
        gradient[0].weights = vec![3.0, -0.01];
        let mut moments = DecoderMoments::zeros(&layers);
        ADAM.step_decoder(&mut layers, &gradient, &mut moments, 0.1, 1.0);
        assert!((layers[0].weights[0] + 0.1).abs() < 1e-6);
        assert!((layers[0].weights[1] - 0.1).abs() < 1e-6);
    }

    #[test]
    fn steps_follow_the_f64_formula() {
        let (mut value, mut first, mut second) = (0.5_f64, 0.0, 0.0);
        let mut layers = vec![DenseLayer::zeros(1, 1)];
        layers[0].weights[0] = 0.5;
        let mut moments = DecoderMoments::zeros(&layers);
        let mut gradient = layers.clone();
        for step in 1..=50 {
            let slope = (f64::from(step) * 0.7).sin();
            first = 0.9 * first + 0.1 * slope;
            second = 0.999 * second + 0.001 * slope * slope;
            let corrected = second / (1.0 - 0.999_f64.powi(step));
            value -= 0.01 * first / (1.0 - 0.9_f64.powi(step)) / (corrected.sqrt() + 1e-8);
            gradient[0].weights[0] = slope as f32;
            ADAM.step_decoder(&mut layers, &gradient, &mut moments, 0.01, 1.0);
        }
        assert!((f64::from(layers[0].weights[0]) - value).abs() < 1e-5);
    }

    #[test]
    fn code_step_leaves_other_rows_alone() {
        let mut table = CodeTable::constant(3, 2, -1.0);
        let gradient = CodeTable::constant(3, 2, 1.0);
        let mut moments = CodeMoments::zeros(&table);
        ADAM.step_code(&mut table, &gradient, &mut moments, 1, 0.1, 1.0);
        assert_eq!(table.log_variance_of(0), [-1.0, -1.0]);
        assert!((table.log_variance_of(1)[0] + 1.1).abs() < 1e-6);
        assert_eq!(table.log_variance_of(2), [-1.0, -1.0]);
        assert_eq!(moments.step_counts, [0, 1, 0]);
    }
}
