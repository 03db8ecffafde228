//! Station 6: checkpoint → blob.
//!
//! In:  a checkpoint and the mixtures of its codes.
//! Out: the bytes of a blob that `karakuri::Model::from_bytes` has accepted.
//!
//! Standardisation is folded into the last layer, so that the device's channels come out in channel units; layer 1 is
//! split into its code half and its time half. Offsets are `karakuri::blob`'s business.

pub mod calibrate;
pub mod effective;
pub mod layer;
pub mod nibble;
pub mod sampler;

use std::f64::consts::TAU;

use half::f16;
use karakuri::manifest::{
    ActivationScale, CODE_LAYER, Group, Joint, LayerShape, Manifest, NumberFormat, Packing,
    Provenance, SamplerKind, TIME_LAYER, TensorKind,
};
use karakuri::{Model, blob::BlobParts, limits};

use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::float_model::{CodeTable, DenseLayer, FloatModel};
use crate::mixture::set::MixtureSet;
use crate::quantize::calibrate::{Observed, calibrate, calibration_cases};
use crate::quantize::layer::{
    InputScale, IntegerLayer, activation_scale, quantize_layer, requantizer_of,
};
use crate::quantize::sampler::{code_fraction_bits, quantize_sampler};

/// What becomes a blob.
#[derive(Clone, Copy)]
pub struct QuantizeInput<'a> {
    /// Free text for the manifest.
    pub name: &'a str,
    /// The decoder.
    pub model: &'a FloatModel,
    /// β of every clip.
    pub sequence_codes: &'a CodeTable,
    /// α of every action.
    pub action_codes: &'a CodeTable,
    /// Layout, actions, standardisation, skeleton.
    pub dataset: &'a DatasetDescription,
    /// Length intervals and mixtures.
    pub mixtures: &'a MixtureSet,
    /// How hidden activations are stored, if tuning has settled that for the format; otherwise it is calibrated.
    pub tuned: Option<&'a [InputScale]>,
    /// Where the checkpoint comes from.
    pub provenance: Provenance,
}

/// A blob and what its making showed.
pub struct Quantized {
    /// The file.
    pub blob: Vec<u8>,
    /// Largest share of 2^31 that any accumulator of a layer can reach; empty for `f16`. // (layer)
    pub accumulator_use: Vec<f64>,
}

/// Quantises a checkpoint to `format`, with a sampler of `sampler_kind`.
///
/// # Errors
/// A shape beyond `karakuri::limits`, or a weight that the format cannot hold; each names what to change.
pub fn quantize(
    input: &QuantizeInput<'_>,
    format: NumberFormat,
    sampler_kind: SamplerKind,
) -> Result<Quantized> {
    let fraction_bits = code_fraction_bits([input.sequence_codes, input.action_codes]);
    let sampler =
        quantize_sampler(sampler_kind, input.sequence_codes, input.mixtures, fraction_bits);
    let layers = split_layers(input.model, input.dataset);
    check_fits(&layers, input)?;
    let quantized = match format {
        NumberFormat::F16 => half_layers(&layers)?,
        NumberFormat::W8A16 | NumberFormat::W8A8 => {
            integer_layers(input, &layers, format, fraction_bits)?
        }
    };
    let mut tensors = sampler.tensors;
    tensors.extend(quantized.tensors);
    tensors.push((TensorKind::Frequencies, frequency_bytes(&input.model.frequencies_rad)));
    tensors.push((TensorKind::ActionCodes, action_code_bytes(input.action_codes, fraction_bits)));
    let dataset = input.dataset;
    let manifest = Manifest {
        name: input.name,
        number_format: format,
        packing: Packing::RowMajor,
        rate_millihz: (dataset.rate_hz * 1000.0).round() as u32,
        group_count: dataset.layout.groups.len() as u16,
        action_count: dataset.actions.len() as u16,
        joint_count: dataset.skeleton.as_ref().map_or(0, |skeleton| skeleton.names.len() as u16),
        sequence_code_count: input.model.sequence_code_count as u16,
        action_code_count: input.model.action_code_count as u16,
        code_fraction_bits: fraction_bits,
        frequency_count: input.model.frequencies_rad.len() as u16,
        layers: quantized.shapes.iter().copied().collect(),
        sampler: sampler.shape,
        provenance: input.provenance,
    };
    let blob = emit(&manifest, dataset, &tensors)?;
    Ok(Quantized { blob, accumulator_use: quantized.accumulator_use })
}

/// Refuses what the manifest's 16-bit counts and bounded list of layers could not even say.
fn check_fits(layers: &[DenseLayer], input: &QuantizeInput<'_>) -> Result<()> {
    let widest =
        layers.iter().map(|layer| layer.input_count.max(layer.output_count)).max().unwrap_or(0);
    let skeleton = input.dataset.skeleton.as_ref();
    let counts = [
        ("layers", layers.len(), limits::LAYERS_MAX),
        ("widest layer", widest, limits::WIDTH_MAX),
        ("channels", input.dataset.layout.channel_count(), limits::CHANNELS_MAX),
        ("numbers of a code", input.model.code_count(), limits::CODE_MAX),
        ("sinusoids", input.model.sinusoid_count(), limits::SINUSOIDS_MAX),
        ("actions", input.dataset.actions.len(), limits::NAMES_MAX),
        ("joints", skeleton.map_or(0, |skeleton| skeleton.names.len()), limits::NAMES_MAX),
        ("clips", input.dataset.clips.len(), usize::from(u16::MAX)),
        ("length intervals", input.mixtures.intervals.len(), usize::from(u16::MAX)),
    ];
    match counts.into_iter().find(|&(_, count, max)| count > max) {
        None => Ok(()),
        Some((field, count, max)) => Err(Error::bad_input(
            input.name,
            field,
            count,
            format!("at most {max}, the device's limit"),
            "train a smaller model",
        )),
    }
}

/// Layers as the device has them: code half, time half (without bias), the others; the last in channel units.
pub(crate) fn split_layers(model: &FloatModel, dataset: &DatasetDescription) -> Vec<DenseLayer> {
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

struct QuantizedLayers {
    shapes: Vec<LayerShape>,
    tensors: Vec<(TensorKind, Vec<u8>)>,
    accumulator_use: Vec<f64>,
}

fn shape_of(layer: &DenseLayer, activation: ActivationScale) -> LayerShape {
    LayerShape {
        input_count: layer.input_count as u16,
        output_count: layer.output_count as u16,
        activation,
    }
}

fn half_layers(layers: &[DenseLayer]) -> Result<QuantizedLayers> {
    let mut tensors = Vec::new();
    for (index, layer) in layers.iter().enumerate() {
        if let Some(weight) =
            layer.weights.iter().find(|&&weight| !f16::from_f32(weight).is_finite())
        {
            return Err(Error::bad_input(
                "checkpoint",
                format!("weight of layer {index}"),
                weight,
                "a magnitude of at most 65504, the largest of binary16",
                "quantise to w8a16, or lower the learning rate and train again",
            ));
        }
        let weights =
            layer.weights.iter().flat_map(|&weight| f16::from_f32(weight).to_le_bytes()).collect();
        tensors.push((TensorKind::Weights(index), weights));
        if index != TIME_LAYER {
            let bias = layer.bias.iter().flat_map(|bias| bias.to_le_bytes()).collect();
            tensors.push((TensorKind::Bias(index), bias));
        }
    }
    let shapes = layers.iter().map(|layer| shape_of(layer, ActivationScale::default())).collect();
    Ok(QuantizedLayers { shapes, tensors, accumulator_use: Vec::new() })
}

fn integer_layers(
    input: &QuantizeInput<'_>,
    layers: &[DenseLayer],
    format: NumberFormat,
    fraction_bits: u8,
) -> Result<QuantizedLayers> {
    let (hidden, means) = match input.tuned {
        Some(hidden) => (hidden.to_vec(), vec![Vec::new(); hidden.len()]),
        None => {
            let observed = observe_activations(input)?;
            let hidden = activation_scales(&observed, format);
            (hidden, observed.into_iter().map(|observed| observed.mean).collect())
        }
    };
    let inputs = input_scales(&hidden, format, fraction_bits);
    let mut result =
        QuantizedLayers { shapes: Vec::new(), tensors: Vec::new(), accumulator_use: Vec::new() };
    let mut time_half = Vec::new();
    // The time half first: the code half is requantised to its accumulators.
    for index in (0..layers.len()).rev() {
        let means =
            index.checked_sub(TIME_LAYER + 1).map_or(&[][..], |above| means[above].as_slice());
        let quantized = quantize_layer(&layers[index], inputs[index], means);
        let factors: Vec<f64> = match index {
            CODE_LAYER => quantized
                .accumulator_scales
                .iter()
                .zip(&time_half)
                .map(|(scale, time)| scale / time)
                .collect(),
            // Pre-activations (for ELU) and channels are both Q15.16.
            _ => quantized.accumulator_scales.iter().map(|scale| scale * 65_536.0).collect(),
        };
        if index == TIME_LAYER {
            time_half.clone_from(&quantized.accumulator_scales);
        }
        let next = if index == CODE_LAYER { None } else { inputs.get(index + 1) };
        result.shapes.insert(
            0,
            shape_of(&layers[index], next.map_or_else(Default::default, stored_activation)),
        );
        result
            .accumulator_use
            .insert(0, quantized.accumulator_use.iter().copied().fold(0.0, f64::max));
        result.tensors.extend(layer_tensors(index, &quantized, &factors));
    }
    Ok(result)
}

/// What flows through the hidden layers for the codes that a device will see. // (hidden layer)
///
/// # Errors
/// Those of [`calibration_cases`].
pub(crate) fn observe_activations(input: &QuantizeInput<'_>) -> Result<Vec<Observed>> {
    let cases = calibration_cases(
        input.sequence_codes,
        input.action_codes,
        input.dataset,
        input.mixtures,
        input.provenance.seed,
    )?;
    Ok(calibrate(input.model, &cases))
}

/// How hidden activations are stored. // (hidden layer)
pub(crate) fn activation_scales(observed: &[Observed], format: NumberFormat) -> Vec<InputScale> {
    observed.iter().map(|observed| activation_scale(observed, format.activation_range())).collect()
}

/// How the inputs of every layer are stored.
pub(crate) fn input_scales(
    hidden: &[InputScale],
    format: NumberFormat,
    fraction_bits: u8,
) -> Vec<InputScale> {
    let code = InputScale {
        scale: 2f64.powi(-i32::from(fraction_bits)),
        zero_point: 0,
        magnitude_max: 1 << 15,
    };
    let one = i64::from(format.sinusoid_one());
    let time = InputScale { scale: 1.0 / one as f64, zero_point: 0, magnitude_max: one };
    [code, time].into_iter().chain(hidden.iter().copied()).collect()
}

fn stored_activation(next: &InputScale) -> ActivationScale {
    let (multiplier, shift) = requantizer_of(1.0 / (65_536.0 * next.scale)).parts();
    ActivationScale { multiplier, shift, zero_point: next.zero_point }
}

fn layer_tensors(
    index: usize,
    layer: &IntegerLayer,
    factors: &[f64],
) -> Vec<(TensorKind, Vec<u8>)> {
    let parts: Vec<(i32, i8)> =
        factors.iter().map(|&factor| requantizer_of(factor).parts()).collect();
    let mut tensors = vec![
        (
            TensorKind::Weights(index),
            layer.weights.iter().map(|weight| weight.cast_unsigned()).collect(),
        ),
        (
            TensorKind::Multipliers(index),
            parts.iter().flat_map(|part| part.0.to_le_bytes()).collect(),
        ),
        (TensorKind::Shifts(index), parts.iter().map(|part| part.1.cast_unsigned()).collect()),
    ];
    if index != TIME_LAYER {
        tensors.push((
            TensorKind::Bias(index),
            layer.bias.iter().flat_map(|bias| bias.to_le_bytes()).collect(),
        ));
    }
    tensors
}

fn frequency_bytes(frequencies_rad: &[f64]) -> Vec<u8> {
    frequencies_rad.iter().flat_map(|&rate_rad| frequency_step(rate_rad).to_le_bytes()).collect()
}

/// Turns per frame · 2^32.
pub(crate) fn frequency_step(rate_rad: f64) -> u32 {
    (rate_rad / TAU * 2f64.powi(32)).round() as u64 as u32
}

fn action_code_bytes(codes: &CodeTable, fraction_bits: u8) -> Vec<u8> {
    let one = f32::from(1u16 << fraction_bits);
    codes.mean.iter().flat_map(|value| ((value * one).round() as i16).to_le_bytes()).collect()
}

fn emit(
    manifest: &Manifest<'_>,
    dataset: &DatasetDescription,
    tensors: &[(TensorKind, Vec<u8>)],
) -> Result<Vec<u8>> {
    let groups: Vec<Group<'_>> = dataset
        .layout
        .groups
        .iter()
        .map(|group| Group { name: &group.name, kind: group.kind, unit: group.unit })
        .collect();
    let actions: Vec<&str> = dataset.actions.iter().map(String::as_str).collect();
    let joints: Vec<Joint<'_>> = dataset.skeleton.iter().flat_map(joints_of).collect();
    let tensors: Vec<(TensorKind, &[u8])> =
        tensors.iter().map(|(kind, bytes)| (*kind, bytes.as_slice())).collect();
    let parts = BlobParts {
        manifest,
        groups: &groups,
        actions: &actions,
        joints: &joints,
        tensors: &tensors,
    };
    let names: usize = groups.iter().map(|group| group.name.len() + 16).sum::<usize>()
        + actions.iter().map(|action| action.len() + 16).sum::<usize>()
        + joints.iter().map(|joint| joint.name.len() + 32).sum::<usize>();
    let space: usize = tensors.iter().map(|(_, bytes)| bytes.len() + 16).sum();
    let mut blob = vec![0; space + names + manifest.name.len() + 4096];
    let refuse = |reason: karakuri::BlobError| Error::Blob {
        path: manifest.name.into(),
        reason: reason.to_string(),
    };
    let length = parts.emit(&mut blob).map_err(refuse)?;
    blob.truncate(length);
    Model::from_bytes(&blob).map_err(refuse)?;
    Ok(blob)
}

fn joints_of(skeleton: &crate::body::skeleton::Skeleton) -> impl Iterator<Item = Joint<'_>> {
    let joints = skeleton.names.iter().zip(&skeleton.parents).zip(&skeleton.offsets);
    joints.map(|((name, parent), &offset)| Joint {
        name,
        parent: parent.map(|parent| parent as u16),
        offset,
    })
}
