//! A small classifier for the tests of this folder, and its formula written out.

use super::Classifier;
use super::recurrent::RecurrentLayer;
use crate::float_model::DenseLayer;

/// Values that look random enough, between -1 and 1.
pub fn values(len: usize) -> Vec<f32> {
    (0..len).map(|index| (index as f32 * 1.7).sin()).collect()
}

/// Two recurrent layers, 5 features, 3 actions.
pub fn classifier(channel_count: usize, unit_count: usize) -> Classifier {
    let widths = [
        (channel_count, 3 * unit_count),
        (unit_count, 3 * unit_count),
        (unit_count, 3 * unit_count),
        (unit_count, 3 * unit_count),
        (unit_count, 5),
        (5, 3),
    ];
    let layer = |(input_count, output_count)| DenseLayer {
        input_count,
        output_count,
        weights: values(input_count * output_count),
        bias: values(output_count),
    };
    Classifier { layers: widths.map(layer).to_vec(), actions: None, description: None }
}

/// Features and logits of one motion, slow, obvious and in f64.
pub fn reference(classifier: &Classifier, poses: &[f32]) -> (Vec<f64>, Vec<f64>) {
    let frames = poses.chunks(classifier.channel_count());
    let mut inputs: Vec<Vec<f64>> =
        frames.map(|pose| pose.iter().map(|x| f64::from(*x)).collect()).collect();
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    for layer in 0..classifier.recurrent_count() {
        let RecurrentLayer { input, recurrent } = classifier.recurrent(layer);
        let count = recurrent.input_count;
        let mut state = vec![0.0; count];
        for frame in &mut inputs {
            let (x, h) = (product(input, frame), product(recurrent, &state));
            for unit in 0..count {
                let r = sigmoid(x[unit] + h[unit]);
                let z = sigmoid(x[count + unit] + h[count + unit]);
                let n = (x[2 * count + unit] + r * h[2 * count + unit]).tanh();
                state[unit] = (1.0 - z) * n + z * state[unit];
            }
            frame.clone_from(&state);
        }
    }
    let [.., feature_layer, logit_layer] = &classifier.layers[..] else { unreachable!() };
    let last = inputs.last().map_or(&[][..], |state| state);
    let features: Vec<f64> = product(feature_layer, last).into_iter().map(f64::tanh).collect();
    let logits = product(logit_layer, &features);
    (features, logits)
}

fn product(layer: &DenseLayer, input: &[f64]) -> Vec<f64> {
    let sum = |(row, bias): (&[f32], &f32)| {
        let products = row.iter().zip(input).map(|(w, x)| f64::from(*w) * x);
        f64::from(*bias) + products.sum::<f64>()
    };
    layer.weights.chunks(layer.input_count).zip(&layer.bias).map(sum).collect()
}
