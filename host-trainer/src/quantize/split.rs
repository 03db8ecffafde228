//! Station 6a: the float model's layers as the device has them.

use crate::dataset::DatasetDescription;
use crate::float_model::{DenseLayer, FloatModel};

/// Code half, time half (without bias), the others; the last with the standardisation folded in, in channel units.
pub fn split_layers(model: &FloatModel, dataset: &DatasetDescription) -> Vec<DenseLayer> {
    let first = &model.layers[0];
    let code_count = model.sequence_code_count + model.action_code_count;
    let columns = |range: std::ops::Range<usize>, bias: Vec<f32>| DenseLayer {
        input_count: range.len(),
        output_count: first.output_count,
        weights: first
            .weights
            .chunks_exact(first.input_count)
            .flat_map(|row| row[range.clone()].iter().copied())
            .collect(),
        bias,
    };
    let mut layers = vec![
        columns(0..code_count, first.bias.clone()),
        columns(code_count..first.input_count, vec![0.0; first.output_count]),
    ];
    layers.extend(model.layers[1..].iter().cloned());
    if let Some(last) = layers.last_mut() {
        let standardization = dataset.mean.iter().zip(&dataset.scale);
        let rows = last.weights.chunks_exact_mut(last.input_count).zip(&mut last.bias);
        for ((weights, bias), (mean, scale)) in rows.zip(standardization) {
            weights.iter_mut().for_each(|weight| *weight *= scale);
            *bias = *bias * scale + mean;
        }
    }
    layers
}
