//! The backward pass: the loss's gradient by the poses → gradients by weights, biases and codes.
//!
//! In:  the activations that `forward` left in the [`Workspace`], and the poses' gradient in its last delta.
//! Out: the decoder's gradient, layer by layer, and the gradient by every code.
//!
//! Why here: layer 1's deltas are summed per code and per moment first, so its products have as few rows as the forward
//! pass. The time embedding is fixed and needs no gradient.

use core::ops::Range;

use faer::prelude::ReborrowMut;
use faer::{Accum, MatRef};
use rayon::prelude::*;

use super::activation::{ActivationGrid, elu_slope};
use super::forward::{Rows, matrix, matrix_mut, multiply, multiply_rows};
use super::modulation::{gate, gate_is_open, phase_gradient};
use super::workspace::{Block, Parts, Pass, Workspace};
use super::{DenseLayer, FloatModel};
use crate::simd::{self, vectorized};

/// Which gradients a backward pass computes.
#[derive(Debug)]
pub struct Wanted<'a> {
    /// The gradient by weights and biases. // (layer)
    pub decoder: Option<&'a mut [DenseLayer]>,
    /// Whether the decoder's gradient is replaced or added to.
    pub accumulate: Accum,
    /// Replaced: the gradient by β and α. // (code, dimension)
    pub codes: Option<&'a mut [f32]>,
}

impl FloatModel {
    /// Computes the wanted gradients of the batch that `forward` just decoded.
    pub fn backward(&self, rows: &Rows<'_>, workspace: &mut Workspace, wanted: Wanted<'_>) {
        let Pass { parts, grids, blocks } = workspace.pass();
        blocks.par_iter_mut().for_each(|block| self.backward_block(rows, parts, grids, block));
        workspace.sum_first_deltas(rows, self);
        if let Some(gradient) = wanted.decoder {
            self.decoder_gradient(rows, workspace, gradient, wanted.accumulate);
        }
        if let Some(gradient) = wanted.codes {
            let code_count = rows.codes.len() / self.code_count();
            let code_sum = &workspace.code_part[..code_count * self.layers[0].output_count];
            let weights = self.layers[0].weight_columns(0..self.code_count());
            multiply_rows(gradient, (Accum::Replace, code_sum), weights);
            if let Some(layer) = &self.modulation {
                let by_row = &workspace.modulation_part[..code_count * layer.output_count];
                multiply_rows(gradient, (Accum::Add, by_row), layer.weight_matrix());
            }
        }
    }

    /// From the deltas of the last layer to those of the first.
    fn backward_block(
        &self,
        rows: &Rows<'_>,
        parts: Parts<'_>,
        grids: &[ActivationGrid],
        block: &mut Block,
    ) {
        let row_count = block.rows.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1).rev() {
            let (before, after) = block.layers.split_at_mut(index);
            let deltas = matrix(after[0].deltas(row_count), layer.output_count);
            let (outputs, target) = before[index - 1].activations_and_deltas_mut(row_count);
            let product = matrix_mut(target, layer.input_count);
            multiply(product, Accum::Replace, deltas, layer.weight_matrix());
            scale_by_slope(target, outputs, grids.get(index - 1));
            let gates = self.gate_rows(index - 1);
            if !gates.is_empty() {
                for (place, &code) in rows.code_of_row[block.rows.clone()].iter().enumerate() {
                    let (deltas, sums) = before[index - 1].deltas_and_sums_mut(place);
                    gate_deltas(deltas, sums, &parts.modulation_of(code, self)[gates.clone()]);
                }
            }
        }
        if self.has_phases() {
            self.backward_phases(block);
        }
    }

    /// The gradient by the phases of every row.
    fn backward_phases(&self, block: &mut Block) {
        let (row_count, first) = (block.rows.len(), &self.layers[0]);
        let sinusoid_count = self.sinusoid_count();
        let deltas = matrix(block.layers[0].deltas(row_count), first.output_count);
        let by_tau = &mut block.tau_deltas[..row_count * sinusoid_count];
        let time_weights = first.weight_columns(self.code_count()..first.input_count);
        multiply(matrix_mut(by_tau, sinusoid_count), Accum::Replace, deltas, time_weights);
        let turned =
            block.tau.chunks_exact(sinusoid_count).zip(by_tau.chunks_exact(sinusoid_count));
        let targets = block.phase_deltas.chunks_exact_mut(sinusoid_count / 2);
        for (by_phase, (turned, by_tau)) in targets.zip(turned) {
            phase_gradient(turned, by_tau, by_phase);
        }
    }

    /// Every layer's gradient, layers and groups of their rows shared among the threads.
    fn decoder_gradient(
        &self,
        rows: &Rows<'_>,
        workspace: &Workspace,
        gradient: &mut [DenseLayer],
        accumulate: Accum,
    ) {
        let (gradient, modulation) = gradient.split_at_mut(self.layers.len());
        let (first, others) = gradient.split_at_mut(1);
        let code_count = self.code_count();
        let width = first[0].output_count;
        let codes = matrix(rows.codes, code_count);
        let tau = matrix(rows.tau, self.sinusoid_count());
        let code_sum = &workspace.code_part[..codes.nrows() * width];
        let time_columns = code_count..self.layers[0].input_count;
        let first_layer = || {
            let by_code = [(code_sum, codes)];
            weight_gradient(&mut first[0], 0..code_count, accumulate, by_code.into_iter());
            if self.has_phases() {
                let by_row = workspace.blocks().iter().map(|block| {
                    let tau = &block.tau[..block.rows.len() * self.sinusoid_count()];
                    let deltas = block.layers[0].deltas(block.rows.len());
                    (deltas, matrix(tau, self.sinusoid_count()))
                });
                weight_gradient(&mut first[0], time_columns, accumulate, by_row);
            } else {
                let time_sum = &workspace.time_part[..tau.nrows() * width];
                let by_time = [(time_sum, tau)];
                weight_gradient(&mut first[0], time_columns, accumulate, by_time.into_iter());
            }
            if let Some(layer) = modulation.first_mut() {
                let by_row = &workspace.modulation_part[..codes.nrows() * layer.output_count];
                weight_gradient(layer, 0..code_count, accumulate, [(by_row, codes)].into_iter());
                sum_rows(&mut layer.bias, accumulate, by_row.chunks_exact(layer.output_count));
            }
            sum_rows(&mut first[0].bias, accumulate, code_sum.chunks_exact(width));
        };
        let other_layers = || {
            others.par_iter_mut().enumerate().for_each(|(before, layer)| {
                let (input_count, output_count) = (layer.input_count, layer.output_count);
                let products = workspace.blocks().iter().map(|block| {
                    let deltas = block.layers[before + 1].deltas(block.rows.len());
                    let input = block.layers[before].activations(block.rows.len());
                    (deltas, matrix(input, input_count))
                });
                weight_gradient(layer, 0..input_count, accumulate, products.clone());
                let rows = products.flat_map(|(deltas, _)| deltas.chunks_exact(output_count));
                sum_rows(&mut layer.bias, accumulate, rows);
            });
        };
        rayon::join(first_layer, other_layers);
    }
}

/// From the gradient by gated sums to that by the sums themselves, and by the gates' rows in place of `sums`.
fn gate_deltas(deltas: &mut [f32], sums: &mut [f32], rows: &[f32]) {
    vectorized(|| {
        for ((delta, sum), &row) in deltas.iter_mut().zip(sums).zip(rows) {
            *sum = if gate_is_open(row) { *sum * *delta } else { 0.0 };
            *delta *= gate(row);
        }
    });
}

/// Turns the gradient by a layer's outputs into that by its sums.
fn scale_by_slope(deltas: &mut [f32], outputs: &[f32], grid: Option<&ActivationGrid>) {
    vectorized(|| match grid {
        None => {
            for (delta, output) in deltas.iter_mut().zip(outputs) {
                *delta *= elu_slope(*output);
            }
        }
        Some(grid) => {
            for (delta, output) in deltas.iter_mut().zip(outputs) {
                *delta *= grid.elu_slope(*output);
            }
        }
    });
}

/// The sum of `deltasᵀ · input` over the products, into some columns of the weight gradient.
///
/// # Shapes
/// `products`: (deltas (row, out), input (row, column))
fn weight_gradient<'a>(
    gradient: &mut DenseLayer,
    columns: Range<usize>,
    accumulate: Accum,
    products: impl Iterator<Item = (&'a [f32], MatRef<'a, f32>)> + Clone + Sync,
) {
    const OUTPUTS_PER_TASK: usize = 64;
    let (input_count, output_count) = (gradient.input_count, gradient.output_count);
    let tasks = gradient.weights.par_chunks_mut(OUTPUTS_PER_TASK * input_count).enumerate();
    tasks.for_each(|(task, weights)| {
        let mut accumulate = accumulate;
        let mut target = matrix_mut(weights, input_count).subcols_mut(columns.start, columns.len());
        for (deltas, input) in products.clone() {
            let outputs = matrix(deltas, output_count)
                .subcols(task * OUTPUTS_PER_TASK, target.nrows())
                .transpose();
            multiply(target.rb_mut(), accumulate, outputs, input);
            accumulate = Accum::Add;
        }
    });
}

/// The sum of all rows, in their order.
fn sum_rows<'a>(sum: &mut [f32], accumulate: Accum, rows: impl Iterator<Item = &'a [f32]>) {
    if accumulate == Accum::Replace {
        sum.fill(0.0);
    }
    rows.for_each(|row| simd::add(sum, row));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float_model::{ModelShape, Modulation};
    use crate::random::{Purpose, stream};

    const CODES: [f32; 10] = [0.5, -1.0, 0.3, 0.9, -0.2, 1.1, 0.4, -0.7, 0.6, 0.1];
    const CODE_OF_ROW: [usize; 5] = [0, 0, 1, 1, 1];
    const MOMENT_OF_ROW: [usize; 5] = [0, 2, 2, 1, 0];
    const TIMES_FRAMES: [f64; 3] = [0.0, 4.0, 2.5];

    fn small_model() -> FloatModel {
        modulated_model(Modulation::None)
    }

    fn modulated_model(modulation: Modulation) -> FloatModel {
        let shape = ModelShape {
            sequence_code_count: 3,
            action_code_count: 2,
            sinusoid_count: 4,
            frequency_base: 10.0,
            hidden_widths: &[7, 6],
            channel_count: 3,
            modulation,
        };
        let mut model = FloatModel::random(&shape, &mut stream(3, Purpose::Weights, 0));
        // Gates start closed to the code; here some lie between their bounds and some beyond.
        if let Some(layer) = &mut model.modulation {
            for (place, weight) in layer.weights.iter_mut().enumerate() {
                *weight += (place as f32 * 1.7).sin();
            }
        }
        model
    }

    const MODULATIONS: [Modulation; 3] =
        [Modulation::None, Modulation::Gates, Modulation::GatesAndPhases];

    fn sums(layer: &DenseLayer, values: &[f64]) -> Vec<f64> {
        let unit = |(weights, bias): (&[f32], &f32)| {
            let products = weights.iter().zip(values).map(|(w, v)| f64::from(*w) * v);
            products.sum::<f64>() + f64::from(*bias)
        };
        layer.weights.chunks(layer.input_count).zip(&layer.bias).map(unit).collect()
    }

    /// Slow, obvious and in f64: half the sum of squares of all poses.
    fn reference_loss(model: &FloatModel, codes: &[f64]) -> f64 {
        let mut loss = 0.0;
        for (code, moment) in CODE_OF_ROW.into_iter().zip(MOMENT_OF_ROW) {
            let mut values = codes[code * 5..][..5].to_vec();
            let modulation = model.modulation.as_ref().map(|layer| sums(layer, &values));
            let modulation = modulation.unwrap_or_default();
            for (frequency, frequency_rad) in model.frequencies_rad.iter().enumerate() {
                let phase_rad = modulation.get(13 + frequency).unwrap_or(&0.0);
                let angle_rad = frequency_rad * TIMES_FRAMES[moment] + phase_rad;
                values.extend([angle_rad.sin(), angle_rad.cos()]);
            }
            for (index, layer) in model.layers.iter().enumerate() {
                values = sums(layer, &values);
                if index + 1 == model.layers.len() {
                    break;
                }
                for (unit, value) in values.iter_mut().enumerate() {
                    let row = modulation.get([0, 7][index] + unit).unwrap_or(&0.0);
                    *value *= (1.0 + row).clamp(0.0, 2.0);
                    *value = if *value < 0.0 { value.exp() - 1.0 } else { *value };
                }
            }
            loss += 0.5 * values.iter().map(|value| value * value).sum::<f64>();
        }
        loss
    }

    /// Loss and gradients by the engine.
    fn engine_gradients(model: &FloatModel) -> (f64, Vec<DenseLayer>, Vec<f32>) {
        let mut tau = vec![0.0; TIMES_FRAMES.len() * 4];
        for (row, time) in tau.chunks_exact_mut(4).zip(TIMES_FRAMES) {
            model.embed_time(time, row);
        }
        let rows = Rows {
            codes: &CODES,
            tau: &tau,
            code_of_row: &CODE_OF_ROW,
            moment_of_row: &MOMENT_OF_ROW,
        };
        let mut workspace = Workspace::new(model, 2, 3, 5);
        model.forward(&rows, &mut workspace);
        let poses = workspace.outputs().flatten();
        let loss = 0.5 * poses.map(|pose| f64::from(pose * pose)).sum::<f64>();
        workspace.outputs_and_deltas().for_each(|(pose, delta)| delta.copy_from_slice(pose));
        let mut decoder: Vec<_> = model.trained_layers().map(DenseLayer::zeros_like).collect();
        let mut codes = vec![0.0; CODES.len()];
        let wanted = Wanted {
            decoder: Some(&mut decoder),
            accumulate: Accum::Replace,
            codes: Some(&mut codes),
        };
        model.backward(&rows, &mut workspace, wanted);
        (loss, decoder, codes)
    }

    fn assert_close(analytic: f32, numeric: f64, what: &str) {
        let difference = (f64::from(analytic) - numeric).abs();
        assert!(difference < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} {numeric}");
    }

    #[test]
    fn loss_equals_the_f64_reference() {
        for modulation in MODULATIONS {
            let model = modulated_model(modulation);
            let (loss, _, _) = engine_gradients(&model);
            assert!((loss - reference_loss(&model, &CODES.map(f64::from))).abs() < 1e-6);
        }
    }

    #[test]
    fn weight_and_bias_gradients_equal_finite_differences() {
        MODULATIONS.map(modulated_model).iter().for_each(check_decoder_gradients);
    }

    fn check_decoder_gradients(model: &FloatModel) {
        let (_, gradient, _) = engine_gradients(model);
        let codes = CODES.map(f64::from);
        // The difference quotient uses the step as f32 really made it, so only the f64 reference's own error is left.
        let quotient = |layer: usize, place: &dyn Fn(&mut DenseLayer) -> &mut f32| {
            let (mut above, mut below) = (model.clone(), model.clone());
            let in_model = |model: &mut FloatModel, step: f32| {
                let value = place(model.trained_layers_mut().nth(layer).unwrap());
                *value += step;
                f64::from(*value)
            };
            let step = in_model(&mut above, 1e-3) - in_model(&mut below, -1e-3);
            (reference_loss(&above, &codes) - reference_loss(&below, &codes)) / step
        };
        for (index, layer) in gradient.iter().enumerate() {
            for (weight, slope) in layer.weights.iter().enumerate() {
                let numeric = quotient(index, &|layer| &mut layer.weights[weight]);
                assert_close(*slope, numeric, &format!("weight {weight} of layer {index}"));
            }
            for (unit, slope) in layer.bias.iter().enumerate() {
                let numeric = quotient(index, &|layer| &mut layer.bias[unit]);
                assert_close(*slope, numeric, &format!("bias {unit} of layer {index}"));
            }
        }
    }

    #[test]
    fn code_gradient_equals_finite_differences() {
        for modulation in MODULATIONS {
            let model = modulated_model(modulation);
            let (_, _, gradient) = engine_gradients(&model);
            for (index, slope) in gradient.into_iter().enumerate() {
                let moved = |step: f64| {
                    let mut codes = CODES.map(f64::from);
                    codes[index] += step;
                    reference_loss(&model, &codes)
                };
                let numeric = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                assert_close(slope, numeric, &format!("code {index}"));
            }
        }
    }

    #[test]
    fn accumulated_gradient_is_the_sum() {
        let model = small_model();
        let (_, once, _) = engine_gradients(&model);
        let rows = Rows {
            codes: &CODES,
            tau: &[0.1; 12],
            code_of_row: &CODE_OF_ROW,
            moment_of_row: &MOMENT_OF_ROW,
        };
        let mut workspace = Workspace::new(&model, 2, 3, 5);
        model.forward(&rows, &mut workspace);
        workspace.outputs_and_deltas().for_each(|(pose, delta)| delta.copy_from_slice(pose));
        let mut alone = once.clone();
        let mut sum = once.clone();
        for (gradient, accumulate) in [(&mut alone, Accum::Replace), (&mut sum, Accum::Add)] {
            let wanted = Wanted { decoder: Some(gradient), accumulate, codes: None };
            let mut workspace = workspace.clone();
            model.backward(&rows, &mut workspace, wanted);
        }
        for layer in 0..once.len() {
            for unit in 0..once[layer].bias.len() {
                let expected = once[layer].bias[unit] + alone[layer].bias[unit];
                assert!((sum[layer].bias[unit] - expected).abs() < 1e-5);
            }
            for weight in 0..once[layer].weights.len() {
                let expected = once[layer].weights[weight] + alone[layer].weights[weight];
                assert!((sum[layer].weights[weight] - expected).abs() < 1e-5);
            }
        }
    }
}
