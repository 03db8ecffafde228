//! The backward pass: the loss's gradient by the poses → gradients by weights, biases and codes.
//!
//! In:  the activations that `forward` left in the [`Workspace`], and the poses' gradient in its last delta.
//! Out: the decoder's gradient, layer by layer, and the gradient by every code.
//!
//! Why here: layer 1's deltas are summed per code and per moment first, so its products have as few rows as the forward
//! pass. The time embedding is fixed and needs no gradient.

use faer::{Accum, MatRef, Par};

use super::activation::elu_slope;
use super::forward::{Rows, Workspace, for_each_row, matrix, matrix_mut, multiply};
use super::{DenseLayer, FloatModel};

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
    pub fn backward(
        &self,
        rows: &Rows<'_>,
        par: Par,
        workspace: &mut Workspace,
        mut wanted: Wanted<'_>,
    ) {
        let row_count = rows.code_of_row.len();
        for (index, layer) in self.layers.iter().enumerate().skip(1).rev() {
            let (before, after) = workspace.deltas.split_at_mut(index);
            let delta = &after[0][..row_count * layer.output_count];
            let input = &workspace.activations[index - 1][..row_count * layer.input_count];
            if let Some(gradient) = wanted.decoder.as_deref_mut() {
                let gradient = &mut gradient[index];
                let input = matrix(input, layer.input_count);
                layer_gradient(gradient, 0, delta, input, wanted.accumulate, par);
                sum_columns(&mut gradient.bias, delta, wanted.accumulate);
            }
            let input_delta = &mut before[index - 1][..row_count * layer.input_count];
            multiply(
                matrix_mut(input_delta, layer.input_count),
                Accum::Replace,
                matrix(delta, layer.output_count),
                layer.weight_matrix(),
                par,
            );
            for_each_row(input_delta, layer.input_count, |row_index, row| {
                let outputs = &input[row_index * layer.input_count..][..layer.input_count];
                for (delta, output) in row.iter_mut().zip(outputs) {
                    *delta *= elu_slope(*output);
                }
            });
        }
        self.backward_first(rows, par, workspace, wanted);
    }

    /// Layer 1: its deltas summed per code and per moment, then the products.
    fn backward_first(
        &self,
        rows: &Rows<'_>,
        par: Par,
        workspace: &mut Workspace,
        wanted: Wanted<'_>,
    ) {
        let layer = &self.layers[0];
        let (width, code_count) = (layer.output_count, self.code_count());
        let delta = &workspace.deltas[0][..rows.code_of_row.len() * width];
        let code_sum = &mut workspace.code_part[..rows.codes.len() / code_count * width];
        add_rows_by_index(code_sum, delta, rows.code_of_row, width);
        if let Some(gradient) = wanted.decoder {
            let moment_count = rows.tau.len() / self.sinusoid_count();
            let time_sum = &mut workspace.time_part[..moment_count * width];
            add_rows_by_index(time_sum, delta, rows.moment_of_row, width);
            let gradient = &mut gradient[0];
            let codes = matrix(rows.codes, code_count);
            let tau = matrix(rows.tau, self.sinusoid_count());
            layer_gradient(gradient, 0, code_sum, codes, wanted.accumulate, par);
            layer_gradient(gradient, code_count, time_sum, tau, wanted.accumulate, par);
            sum_columns(&mut gradient.bias, code_sum, wanted.accumulate);
        }
        if let Some(code_gradient) = wanted.codes {
            multiply(
                matrix_mut(code_gradient, code_count),
                Accum::Replace,
                matrix(code_sum, width),
                layer.weight_columns(0..code_count),
                par,
            );
        }
    }
}

/// `deltaᵀ · input`, into the weight gradient's columns from `first_column` on.
fn layer_gradient(
    gradient: &mut DenseLayer,
    first_column: usize,
    delta: &[f32],
    input: MatRef<'_, f32>,
    accumulate: Accum,
    par: Par,
) {
    let columns = matrix_mut(&mut gradient.weights, gradient.input_count)
        .subcols_mut(first_column, input.ncols());
    let delta = matrix(delta, gradient.output_count).transpose();
    multiply(columns, accumulate, delta, input, par);
}

/// The sum of all rows, in row order.
fn sum_columns(sums: &mut [f32], rows: &[f32], accumulate: Accum) {
    if accumulate == Accum::Replace {
        sums.fill(0.0);
    }
    for row in rows.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// Replaces each sum by that of the rows which name it, in row order.
fn add_rows_by_index(sums: &mut [f32], rows: &[f32], index_of_row: &[usize], width: usize) {
    sums.fill(0.0);
    for (row, &index) in rows.chunks_exact(width).zip(index_of_row) {
        for (sum, value) in sums[index * width..][..width].iter_mut().zip(row) {
            *sum += value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float_model::ModelShape;
    use crate::random::{Purpose, stream};

    const CODES: [f32; 10] = [0.5, -1.0, 0.3, 0.9, -0.2, 1.1, 0.4, -0.7, 0.6, 0.1];
    const CODE_OF_ROW: [usize; 5] = [0, 0, 1, 1, 1];
    const MOMENT_OF_ROW: [usize; 5] = [0, 2, 2, 1, 0];
    const TIMES_FRAMES: [f64; 3] = [0.0, 4.0, 2.5];

    fn small_model() -> FloatModel {
        let shape = ModelShape {
            sequence_code_count: 3,
            action_code_count: 2,
            sinusoid_count: 4,
            frequency_base: 10.0,
            hidden_widths: &[7, 6],
            channel_count: 3,
        };
        FloatModel::random(&shape, &mut stream(3, Purpose::Weights, 0))
    }

    /// Slow, obvious and in f64: half the sum of squares of all poses.
    fn reference_loss(model: &FloatModel, codes: &[f64]) -> f64 {
        let mut loss = 0.0;
        for (code, moment) in CODE_OF_ROW.into_iter().zip(MOMENT_OF_ROW) {
            let mut values = codes[code * 5..][..5].to_vec();
            for frequency_rad in &model.frequencies_rad {
                let phase_rad = frequency_rad * TIMES_FRAMES[moment];
                values.extend([phase_rad.sin(), phase_rad.cos()]);
            }
            for (index, layer) in model.layers.iter().enumerate() {
                let is_last = index + 1 == model.layers.len();
                let unit = |(weights, bias): (&[f32], &f32)| {
                    let products = weights.iter().zip(&values).map(|(w, v)| f64::from(*w) * v);
                    let sum = products.sum::<f64>() + f64::from(*bias);
                    if sum < 0.0 && !is_last { sum.exp() - 1.0 } else { sum }
                };
                let rows = layer.weights.chunks(layer.input_count).zip(&layer.bias);
                values = rows.map(unit).collect();
            }
            loss += 0.5 * values.iter().map(|value| value * value).sum::<f64>();
        }
        loss
    }

    /// Loss and gradients by the engine.
    fn engine_gradients(model: &FloatModel, par: Par) -> (f64, Vec<DenseLayer>, Vec<f32>) {
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
        model.forward(&rows, par, &mut workspace);
        let (poses, deltas) = workspace.output_and_delta(5);
        deltas.copy_from_slice(poses);
        let loss = 0.5 * poses.iter().map(|pose| f64::from(pose * pose)).sum::<f64>();
        let mut decoder: Vec<_> = model.layers.iter().map(DenseLayer::zeros_like).collect();
        let mut codes = vec![0.0; CODES.len()];
        let wanted = Wanted {
            decoder: Some(&mut decoder),
            accumulate: Accum::Replace,
            codes: Some(&mut codes),
        };
        model.backward(&rows, par, &mut workspace, wanted);
        (loss, decoder, codes)
    }

    fn assert_close(analytic: f32, numeric: f64, what: &str) {
        let difference = (f64::from(analytic) - numeric).abs();
        assert!(difference < 1e-5 * (1.0 + numeric.abs()), "{what}: {analytic} {numeric}");
    }

    #[test]
    fn loss_equals_the_f64_reference() {
        let model = small_model();
        let (loss, _, _) = engine_gradients(&model, Par::Seq);
        assert!((loss - reference_loss(&model, &CODES.map(f64::from))).abs() < 1e-6);
    }

    #[test]
    fn weight_and_bias_gradients_equal_finite_differences() {
        let model = small_model();
        let (_, gradient, _) = engine_gradients(&model, Par::Seq);
        let codes = CODES.map(f64::from);
        // The difference quotient uses the step as f32 really made it, so only the f64 reference's own error is left.
        let quotient = |place: &dyn Fn(&mut FloatModel) -> &mut f32| {
            let (mut above, mut below) = (model.clone(), model.clone());
            *place(&mut above) += 1e-3;
            *place(&mut below) -= 1e-3;
            let step = f64::from(*place(&mut above)) - f64::from(*place(&mut below));
            (reference_loss(&above, &codes) - reference_loss(&below, &codes)) / step
        };
        for (index, layer) in gradient.iter().enumerate() {
            for (weight, slope) in layer.weights.iter().enumerate() {
                let numeric = quotient(&|model| &mut model.layers[index].weights[weight]);
                assert_close(*slope, numeric, &format!("weight {weight} of layer {index}"));
            }
            for (unit, slope) in layer.bias.iter().enumerate() {
                let numeric = quotient(&|model| &mut model.layers[index].bias[unit]);
                assert_close(*slope, numeric, &format!("bias {unit} of layer {index}"));
            }
        }
    }

    #[test]
    fn code_gradient_equals_finite_differences() {
        let model = small_model();
        let (_, _, gradient) = engine_gradients(&model, Par::Seq);
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

    #[test]
    fn accumulated_gradient_is_the_sum() {
        let model = small_model();
        let (_, once, _) = engine_gradients(&model, Par::Seq);
        let rows = Rows {
            codes: &CODES,
            tau: &[0.1; 12],
            code_of_row: &CODE_OF_ROW,
            moment_of_row: &MOMENT_OF_ROW,
        };
        let mut workspace = Workspace::new(&model, 2, 3, 5);
        model.forward(&rows, Par::Seq, &mut workspace);
        let (poses, deltas) = workspace.output_and_delta(5);
        deltas.copy_from_slice(poses);
        let mut alone = once.clone();
        let mut sum = once.clone();
        for (gradient, accumulate) in [(&mut alone, Accum::Replace), (&mut sum, Accum::Add)] {
            let wanted = Wanted { decoder: Some(gradient), accumulate, codes: None };
            let mut workspace = workspace.clone();
            model.backward(&rows, Par::Seq, &mut workspace, wanted);
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
