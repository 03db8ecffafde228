//! Station 6b, read backwards: the real weights that the device's integers stand for.
//!
//! In:  a float model, how the inputs of its layers are stored, the number format.
//! Out: a float model whose weights and biases are those that a blob would hold, to `tune`.
//!
//! Why here: tuning must see what the quantiser stores, so both call the same functions; this file only multiplies the
//! scales back in.

use karakuri::manifest::{CODE_LAYER, TIME_LAYER, WeightFormat};

use crate::dataset::DatasetDescription;
use crate::float_model::{DenseLayer, FloatModel};
use crate::quantize::integer_layers::{IntegerInput, input_scales, product_unit};
use crate::quantize::layer::{InputScale, quantize_layer};
use crate::quantize::nibble::quantize_nibble_row;
use crate::quantize::split::split_modulation;

/// The model as the device computes it, in standardised channels; `stored` says how the layers of `model` are stored.
pub fn effective_model(
    model: &FloatModel,
    dataset: &DatasetDescription,
    stored: IntegerInput<'_>,
) -> FloatModel {
    let inputs = input_scales(stored);
    let layers = stored.layers.iter().zip(&inputs).enumerate();
    let layers = layers.map(|(index, (layer, &input))| match stored.weights[index] {
        WeightFormat::I4 => effective_nibbles(layer, input),
        _ => effective_bytes(layer, input, product_unit(index, stored.format)),
    });
    let mut layers: Vec<DenseLayer> = layers.collect();
    let time_half = layers.remove(TIME_LAYER);
    let modulation = model.modulation.as_ref();
    let modulation = modulation.map(|_| split_modulation(&layers[CODE_LAYER], model));
    layers[CODE_LAYER] = join_halves(&layers[CODE_LAYER], &time_half);
    if let Some(last) = layers.last_mut() {
        standardize(last, dataset);
    }
    FloatModel {
        sequence_code_count: model.sequence_code_count,
        action_code_count: model.action_code_count,
        frequencies_rad: model.frequencies_rad.clone(),
        layers,
        modulation,
    }
}

/// A layer of `w8a16` or `w8a8`, as real numbers.
fn effective_bytes(layer: &DenseLayer, input: InputScale, product_unit: i64) -> DenseLayer {
    let stored = quantize_layer(layer, input, &[], product_unit);
    let mut effective = layer.zeros_like();
    let rows = stored.weights.chunks_exact(layer.input_count).zip(&stored.bias);
    let targets = effective.weights.chunks_exact_mut(layer.input_count).zip(&mut effective.bias);
    for (((weights, bias), scale), (target, target_bias)) in
        rows.zip(&stored.accumulator_scales).zip(targets)
    {
        let weight_scale = scale / input.scale * product_unit as f64;
        for (target, &weight) in target.iter_mut().zip(weights) {
            *target = (f64::from(weight) * weight_scale) as f32;
        }
        let sum: i64 = weights.iter().map(|&weight| i64::from(weight)).sum();
        let zero_products = i64::from(input.zero_point) * sum * product_unit;
        *target_bias = ((i64::from(*bias) + zero_products) as f64 * scale) as f32;
    }
    effective
}

/// A layer of `w4a8`, as real numbers.
fn effective_nibbles(layer: &DenseLayer, input: InputScale) -> DenseLayer {
    let mut effective = layer.zeros_like();
    let rows = layer.weights.chunks_exact(layer.input_count).zip(&layer.bias);
    let targets = effective.weights.chunks_exact_mut(layer.input_count).zip(&mut effective.bias);
    for ((weights, &bias), (target, target_bias)) in rows.zip(targets) {
        let row = quantize_nibble_row(weights, f64::from(bias), input, &[]);
        for (target, weight) in target.iter_mut().zip(row.effective_weights()) {
            *target = weight as f32;
        }
        // Padding columns hold the zero point too.
        let sum: f64 = row.effective_weights().sum();
        let stored = f64::from(row.bias) * row.scale + f64::from(input.zero_point) * sum;
        *target_bias = (stored * input.scale) as f32;
    }
    effective
}

/// Layer 1 as the float model has it: one row over code and time.
fn join_halves(code_half: &DenseLayer, time_half: &DenseLayer) -> DenseLayer {
    let rows = code_half.weights.chunks_exact(code_half.input_count);
    let rows = rows.zip(time_half.weights.chunks_exact(time_half.input_count));
    DenseLayer {
        input_count: code_half.input_count + time_half.input_count,
        output_count: time_half.output_count,
        weights: rows.flat_map(|(code, time)| code.iter().chain(time)).copied().collect(),
        bias: code_half.bias[..time_half.output_count].to_vec(),
    }
}

/// Undoes what `split_layers` folds into the last layer.
fn standardize(last: &mut DenseLayer, dataset: &DatasetDescription) {
    let standardization = dataset.mean.iter().zip(&dataset.scale);
    let rows = last.weights.chunks_exact_mut(last.input_count).zip(&mut last.bias);
    for ((weights, bias), (mean, scale)) in rows.zip(standardization) {
        weights.iter_mut().for_each(|weight| *weight /= scale);
        *bias = (*bias - mean) / scale;
    }
}
