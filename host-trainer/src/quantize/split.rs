//! Station 6a: the float model's layers as the device has them.

use crate::dataset::DatasetDescription;
use crate::float_model::{DenseLayer, FloatModel};

/// Code half, time half (without bias), the others; the last with the standardisation folded in, in channel units.
///
/// Gates and phases follow the code half's own rows, as `Manifest::has_gates` orders them: gates as shares of their
/// largest value, phases in turns.
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
    append_modulation(&mut layers[0], model);
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

/// Rows of every hidden layer's gates and of the phases, each filled up to a whole block.
fn append_modulation(code_half: &mut DenseLayer, model: &FloatModel) {
    let Some(modulation) = &model.modulation else {
        return;
    };
    fill_block(code_half);
    let gates = (0..model.layers.len() - 1).map(|layer| (model.gate_rows(layer), gate_share()));
    let phases = (model.phase_rows(), [TURN, 0.0]);
    for (rows, [factor, start]) in gates.chain([phases]) {
        let columns = modulation.input_count;
        let weights = &modulation.weights[rows.start * columns..rows.end * columns];
        code_half.weights.extend(weights.iter().map(|weight| weight * factor));
        code_half.bias.extend(modulation.bias[rows].iter().map(|bias| bias * factor + start));
        fill_block(code_half);
    }
}

/// Turns of a radian.
const TURN: f32 = (0.5 / std::f64::consts::PI) as f32;

/// Factor and start that make of a gate's row its share of the largest gate.
fn gate_share() -> [f32; 2] {
    [1.0 / karakuri::manifest::GATE_MAX as f32; 2]
}

/// Rows of zeros up to the next multiple of four.
fn fill_block(layer: &mut DenseLayer) {
    layer.output_count = layer.bias.len().next_multiple_of(4);
    layer.bias.resize(layer.output_count, 0.0);
    layer.weights.resize(layer.output_count * layer.input_count, 0.0);
}

/// Gates and phases as the float model has them, back from the code half's rows.
pub fn split_modulation(code_half: &DenseLayer, model: &FloatModel) -> DenseLayer {
    let mut modulation = DenseLayer::zeros(code_half.input_count, 0);
    let mut row = model.layers[0].output_count.next_multiple_of(4);
    let gates =
        (0..model.layers.len() - 1).map(|layer| (model.gate_rows(layer).len(), gate_share()));
    let phases = (model.phase_rows().len(), [TURN, 0.0]);
    for (count, [factor, start]) in gates.chain([phases]) {
        let weights = &code_half.weights[row * code_half.input_count..];
        let weights = &weights[..count * code_half.input_count];
        modulation.weights.extend(weights.iter().map(|weight| weight / factor));
        let bias = &code_half.bias[row..row + count];
        modulation.bias.extend(bias.iter().map(|bias| (bias - start) / factor));
        row += count.next_multiple_of(4);
    }
    modulation.output_count = modulation.bias.len();
    modulation
}
