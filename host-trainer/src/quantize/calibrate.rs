//! Station 6a: which values flow through the decoder, so that the quantiser can choose scales.
//!
//! In:  the float model, and codes like those the device will see: the clips' own and mixture draws.
//! Out: the values at the input of every layer, as ranges, means and histograms.
//!
//! Why here: post-training quantisation needs nothing of the training poses but the activations they cause, and those
//! follow from codes and times alone.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::dataset::DatasetDescription;
use crate::error::Result;
use crate::float_model::modulation::gate;
use crate::float_model::{CodeTable, DenseLayer, FloatModel};
use crate::mixture::set::MixtureSet;

/// One decoding to observe.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationCase {
    /// β then α.
    pub code: Vec<f32>,
    /// Frame positions to decode.
    pub frames: Vec<f64>,
}

/// Clips calibrated on, at most; more hardly move a range and take long at the paper's size.
const CLIP_COUNT_MAX: usize = 300;
/// Frames of each case, evenly spaced over the clip.
const FRAME_COUNT: usize = 8;

/// Every clip's own code, and a draw from the mixture for its action and length; more of them where clips are few.
///
/// # Errors
/// Those of [`MixtureSet::sample`]; none for the mixtures of the same dataset.
pub fn calibration_cases(
    sequence_codes: &CodeTable,
    action_codes: &CodeTable,
    dataset: &DatasetDescription,
    mixtures: &MixtureSet,
    seed: u64,
) -> Result<Vec<CalibrationCase>> {
    let stride = dataset.clips.len().div_ceil(CLIP_COUNT_MAX).max(1);
    let draws_per_clip = (CLIP_COUNT_MAX / dataset.clips.len().max(1)).max(1);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut cases = Vec::new();
    for (row, clip) in dataset.clips.iter().enumerate().step_by(stride) {
        let last = (clip.frame_count - 1) as f64;
        let frames: Vec<f64> =
            (0..FRAME_COUNT).map(|i| last * i as f64 / (FRAME_COUNT - 1) as f64).collect();
        let action_code = action_codes.mean_of(clip.action);
        let own = sequence_codes.mean_of(row).to_vec();
        let mut codes = vec![own];
        for _ in 0..draws_per_clip {
            let drawn = mixtures.sample(clip.action, clip.frame_count, &mut random)?;
            codes.push(drawn.into_iter().map(|value| value as f32).collect());
        }
        cases.extend(codes.into_iter().map(|sequence_code| CalibrationCase {
            code: [sequence_code.as_slice(), action_code].concat(),
            frames: frames.clone(),
        }));
    }
    Ok(cases)
}

/// Inputs of one layer over all cases.
#[derive(Clone, Debug, PartialEq)]
pub struct Observed {
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// Mean of each input. // (input)
    pub mean: Vec<f32>,
    /// An even subset of the values, to try scales on.
    pub values: Vec<f32>,
}

/// Values kept per layer; enough for stable percentiles, small enough to try dozens of scales on.
const VALUE_COUNT_MAX: usize = 200_000;

/// Decodes all cases and observes the input of every layer after the first. // (layer - 1)
pub fn calibrate(model: &FloatModel, cases: &[CalibrationCase]) -> Vec<Observed> {
    let inputs: Vec<Vec<Vec<f32>>> =
        cases.par_iter().flat_map_iter(|case| observe(model, case)).collect();
    (0..model.layers.len() - 1).map(|layer| summarize(&inputs, layer)).collect()
}

/// The pose of a code at a frame, in standardised channels.
pub fn decode_float(model: &FloatModel, code: &[f32], frame: f64) -> Vec<f32> {
    let last = model.layers.last().expect("a model has layers");
    let hidden = hidden_activations(model, code, frame);
    dense(last, hidden.last().expect("a model has hidden layers"))
}

/// Outputs of every hidden layer. // (hidden layer)(unit)
fn hidden_activations(model: &FloatModel, code: &[f32], frame: f64) -> Vec<Vec<f32>> {
    let modulation = model.modulation.as_ref().map(|layer| dense(layer, code)).unwrap_or_default();
    let phases = &modulation[model.phase_rows()];
    let mut values = first_inputs(model, code, frame, phases);
    let mut outputs = Vec::with_capacity(model.layers.len() - 1);
    for (index, layer) in model.layers[..model.layers.len() - 1].iter().enumerate() {
        values = dense(layer, &values);
        values
            .iter_mut()
            .zip(&modulation[model.gate_rows(index)])
            .for_each(|(v, row)| *v *= gate(*row));
        values.iter_mut().for_each(|value| *value = elu(*value));
        outputs.push(values.clone());
    }
    outputs
}

/// β, α, τ(t).
fn first_inputs(model: &FloatModel, code: &[f32], frame: f64, phases: &[f32]) -> Vec<f32> {
    let phases = phases.iter().copied().chain(std::iter::repeat(0.0));
    let sinusoids = model.frequencies_rad.iter().zip(phases).flat_map(|(rate_rad, phase)| {
        let (sine, cosine) = (rate_rad * frame + f64::from(phase)).sin_cos();
        [sine as f32, cosine as f32]
    });
    code.iter().copied().chain(sinusoids).collect()
}

/// Inputs of every layer after the first, for every frame of a case. // (frame)(layer - 1)(input)
fn observe(model: &FloatModel, case: &CalibrationCase) -> Vec<Vec<Vec<f32>>> {
    let frames = case.frames.iter();
    frames.map(|&frame| hidden_activations(model, &case.code, frame)).collect()
}

fn elu(sum: f32) -> f32 {
    if sum >= 0.0 { sum } else { sum.exp_m1() }
}

fn dense(layer: &DenseLayer, input: &[f32]) -> Vec<f32> {
    let row = |(weights, bias): (&[f32], &f32)| {
        weights.iter().zip(input).map(|(weight, value)| weight * value).sum::<f32>() + bias
    };
    layer.weights.chunks_exact(layer.input_count).zip(&layer.bias).map(row).collect()
}

fn summarize(inputs: &[Vec<Vec<f32>>], layer: usize) -> Observed {
    let width = inputs.first().map_or(0, |layers| layers[layer].len());
    let mut sums = vec![0.0f64; width];
    for layers in inputs {
        for (sum, value) in sums.iter_mut().zip(&layers[layer]) {
            *sum += f64::from(*value);
        }
    }
    let all = || inputs.iter().flat_map(|layers| layers[layer].iter().copied());
    let stride = (inputs.len() * width).div_ceil(VALUE_COUNT_MAX).max(1);
    Observed {
        min: all().fold(0.0, f32::min),
        max: all().fold(0.0, f32::max),
        mean: sums.iter().map(|sum| (sum / inputs.len().max(1) as f64) as f32).collect(),
        values: all().step_by(stride).collect(),
    }
}
