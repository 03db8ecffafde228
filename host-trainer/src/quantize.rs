//! Station 6: checkpoint → blob.
//!
//! In:  a checkpoint and the mixtures of its codes.
//! Out: the bytes of a blob that `karakuri::Model::from_bytes` has accepted.
//!
//! Standardisation is folded into the last layer, so that the device's channels come out in channel units; layer 1 is
//! split into its code half and its time half. Offsets are `karakuri::blob`'s business.

// In the order of the data's journey.
pub mod split;
pub mod calibrate;
pub mod effective;
pub mod layer;
pub mod nibble;
pub mod scale;
pub mod stored;
pub mod half_layers;
pub mod integer_layers;
pub mod sampler;
pub mod time_table;
pub mod flash_budget;

use std::f64::consts::TAU;

use karakuri::manifest::{
    Group, Joint, Manifest, NumberFormat, Packing, Provenance, TensorKind, WeightFormat,
};
use karakuri::{Model, blob::BlobParts, limits};

use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::float_model::{CodeTable, DenseLayer, FloatModel};
use crate::mixture::set::MixtureSet;
use crate::quantize::calibrate::{CalibrationCase, Observed, calibrate, calibration_cases};
use crate::quantize::half_layers::half_layers;
use crate::quantize::integer_layers::{IntegerInput, integer_layers};
use crate::quantize::layer::{InputScale, activation_scale};
use crate::quantize::sampler::{code_fraction_bits, quantize_sampler};
use crate::quantize::split::split_layers;
use crate::quantize::stored::StoredLayers;
use crate::quantize::time_table::{TimeTable, time_table};
use crate::sampler::SamplerChoice;
use crate::sampler::nearest_clips::ClipOptions;

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

impl QuantizeInput<'_> {
    /// Codes like those that the device will see.
    ///
    /// # Errors
    /// Those of [`calibration_cases`].
    pub fn calibration_cases(&self) -> Result<Vec<CalibrationCase>> {
        let seed = self.provenance.seed;
        calibration_cases(self.sequence_codes, self.action_codes, self.dataset, self.mixtures, seed)
    }
}

/// A blob and what its making showed.
pub struct Quantized {
    /// The file.
    pub blob: Vec<u8>,
    /// Largest share of 2^31 that any accumulator of a layer can reach; empty for `f16`. // (layer)
    pub accumulator_use: Vec<f64>,
}

/// How it becomes a blob.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantizeOptions {
    /// Of weights and activations.
    pub format: NumberFormat,
    /// Order of 8-bit weights.
    pub packing: Packing,
    /// How the device draws codes.
    pub sampler: SamplerChoice,
    /// Weights of each layer (code half, time half, the others); `None`: see [`default_weights`].
    pub weights: Option<Vec<WeightFormat>>,
    /// Whole frames whose time half is stored; 0 is none.
    pub time_table_frames: u16,
}

impl QuantizeOptions {
    /// Tiles, nearest clips, no time table.
    pub const fn new(format: NumberFormat) -> Self {
        Self {
            format,
            packing: Packing::Tiles,
            sampler: SamplerChoice::NearestClips(ClipOptions::DEFAULT),
            weights: None,
            time_table_frames: 0,
        }
    }
}

/// How the inputs of the layers after the time half are stored, and what to correct biases with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HiddenInputs {
    /// // (hidden layer)
    pub scales: Vec<InputScale>,
    /// Mean of each input; empty where there is nothing to correct. // (hidden layer)(input)
    pub means: Vec<Vec<f32>>,
}

impl HiddenInputs {
    /// As tuning has settled it, otherwise calibrated; empty for `f16`.
    ///
    /// # Errors
    /// Those of [`calibration_cases`].
    pub fn new(input: &QuantizeInput<'_>, format: NumberFormat) -> Result<Self> {
        if format == NumberFormat::F16 {
            return Ok(Self::default());
        }
        // Tuning has learned biases for the very weights; there is nothing to correct.
        if let Some(scales) = input.tuned {
            return Ok(Self { scales: scales.to_vec(), means: vec![Vec::new(); scales.len()] });
        }
        let observed = observe_activations(input)?;
        let scales = activation_scales(&observed, format);
        Ok(Self { scales, means: observed.into_iter().map(|observed| observed.mean).collect() })
    }
}

/// Quantises a checkpoint.
///
/// # Errors
/// A shape beyond `karakuri::limits`, or a weight that the format cannot hold; each names what to change.
pub fn quantize(input: &QuantizeInput<'_>, options: &QuantizeOptions) -> Result<Quantized> {
    quantize_with(input, options, &HiddenInputs::new(input, options.format)?)
}

/// [`quantize`] with what calibration has already found.
///
/// # Errors
/// Those of [`quantize`].
pub fn quantize_with(
    input: &QuantizeInput<'_>,
    options: &QuantizeOptions,
    hidden: &HiddenInputs,
) -> Result<Quantized> {
    let fraction_bits = code_fraction_bits([input.sequence_codes, input.action_codes]);
    let layers = split_layers(input.model, input.dataset);
    check_fits(&layers, input)?;
    let stored = store_layers(options, &layers, hidden, fraction_bits)?;
    let mut blob = assemble(input, options, &stored, fraction_bits, None)?;
    if options.time_table_frames > 0 {
        // The table is made by the device's own arithmetic, from the blob that has none.
        let table = time_table(&load(input.name, &blob)?, options.time_table_frames)?;
        blob = assemble(input, options, &stored, fraction_bits, Some(&table))?;
    }
    Ok(Quantized { blob, accumulator_use: stored.accumulator_use })
}

fn store_layers(
    options: &QuantizeOptions,
    layers: &[DenseLayer],
    hidden: &HiddenInputs,
    code_fraction_bits: u8,
) -> Result<StoredLayers> {
    if options.format == NumberFormat::F16 {
        return half_layers(layers);
    }
    let (format, packing) = (options.format, options.packing);
    let weights = options.weights.clone().unwrap_or_else(|| default_weights(format, layers));
    integer_layers(IntegerInput {
        layers,
        hidden: &hidden.scales,
        means: &hidden.means,
        format,
        packing,
        weights: &weights,
        code_fraction_bits,
    })
}

/// Weights of each layer, unless they are asked for: 4 bits only where that saves flash.
///
/// A layer of less than 1/32 of all weights keeps 8 bits in `w4a8`: together these are 2 % of a model, and the last
/// layer, whose errors are those of the pose, is among them. At 4 bits it alone made half of the square error of
/// preset `small` on Chako and Reachy.
pub fn default_weights(format: NumberFormat, layers: &[DenseLayer]) -> Vec<WeightFormat> {
    let all: usize = layers.iter().map(|layer| layer.weights.len()).sum();
    let of_layer = |layer: &DenseLayer| match format {
        NumberFormat::W4A8 if layer.weights.len() >= all / 32 => WeightFormat::I4,
        NumberFormat::W4A8 | NumberFormat::W8A16 | NumberFormat::W8A8 => WeightFormat::I8,
        NumberFormat::F16 => WeightFormat::Half,
    };
    layers.iter().map(of_layer).collect()
}

/// What flows through the hidden layers for the codes that a device will see. // (hidden layer)
///
/// # Errors
/// Those of [`calibration_cases`].
pub fn observe_activations(input: &QuantizeInput<'_>) -> Result<Vec<Observed>> {
    Ok(calibrate(input.model, &input.calibration_cases()?))
}

/// How hidden activations are stored. // (hidden layer)
pub fn activation_scales(observed: &[Observed], format: NumberFormat) -> Vec<InputScale> {
    observed.iter().map(|observed| activation_scale(observed, format.activation_range())).collect()
}

fn assemble(
    input: &QuantizeInput<'_>,
    options: &QuantizeOptions,
    stored: &StoredLayers,
    fraction_bits: u8,
    table: Option<&TimeTable>,
) -> Result<Vec<u8>> {
    let sampler = quantize_sampler(
        options.sampler,
        input.sequence_codes,
        input.dataset,
        input.mixtures,
        fraction_bits,
    );
    let mut tensors = sampler.tensors;
    tensors.extend(stored.tensors.iter().cloned());
    tensors.push((TensorKind::Frequencies, frequency_bytes(&input.model.frequencies_rad)));
    tensors.push((TensorKind::ActionCodes, action_code_bytes(input.action_codes, fraction_bits)));
    tensors.extend(table.map(|table| (TensorKind::TimeTable, table.bytes())));
    let dataset = input.dataset;
    let manifest = Manifest {
        name: input.name,
        number_format: options.format,
        packing: options.packing,
        rate_millihz: (dataset.rate_hz * 1000.0).round() as u32,
        group_count: dataset.layout.groups.len() as u16,
        action_count: dataset.actions.len() as u16,
        joint_count: dataset.skeleton.as_ref().map_or(0, |skeleton| skeleton.names.len() as u16),
        sequence_code_count: input.model.sequence_code_count as u16,
        action_code_count: input.model.action_code_count as u16,
        code_fraction_bits: fraction_bits,
        frequency_count: input.model.frequencies_rad.len() as u16,
        layers: stored.shapes.iter().copied().collect(),
        sampler: sampler.shape,
        time_table_frames: table.map_or(0, |table| table.frames),
        time_table_shift: table.map_or(0, |table| table.shift),
        provenance: input.provenance,
    };
    emit(&manifest, dataset, &tensors)
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

fn frequency_bytes(frequencies_rad: &[f64]) -> Vec<u8> {
    frequencies_rad.iter().flat_map(|&rate_rad| frequency_step(rate_rad).to_le_bytes()).collect()
}

/// Turns per frame · 2^32.
pub fn frequency_step(rate_rad: f64) -> u32 {
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
    let length = parts.emit(&mut blob).map_err(|reason| refused(manifest.name, reason))?;
    blob.truncate(length);
    load(manifest.name, &blob)?;
    Ok(blob)
}

fn load<'a>(name: &str, blob: &'a [u8]) -> Result<Model<'a>> {
    Model::from_bytes(blob).map_err(|reason| refused(name, reason))
}

fn refused(name: &str, reason: karakuri::BlobError) -> Error {
    Error::Blob { path: name.into(), reason: reason.to_string() }
}

fn joints_of(skeleton: &crate::body::skeleton::Skeleton) -> impl Iterator<Item = Joint<'_>> {
    let joints = skeleton.names.iter().zip(&skeleton.parents).zip(&skeleton.offsets);
    joints.map(|((name, parent), &offset)| Joint {
        name,
        parent: parent.map(|parent| parent as u16),
        offset,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_that_save_no_flash_keep_eight_bits() {
        let layers = [(64, 96), (64, 96), (96, 96), (96, 6)]
            .map(|(input_count, output_count)| DenseLayer::zeros(input_count, output_count));
        let weights = default_weights(NumberFormat::W4A8, &layers);
        assert_eq!(weights[..3], [WeightFormat::I4; 3]);
        assert_eq!(weights[3], WeightFormat::I8);
        assert_eq!(default_weights(NumberFormat::W8A8, &layers), [WeightFormat::I8; 4]);
    }
}
