//! Models of given shapes with weights from a generator: what is to be counted needs no training.
//!
//! In:  a [`Network`], a number format, an order of weights.
//! Out: bytes of a blob.
//!
//! Why here: counts depend on shapes, formats and, a little, on the signs of pre-activations. Weights are drawn with
//! the spread that keeps activations in a trained network's range; see `layer.rs`. Only sums, products and square
//! roots, so the same bytes come out on every machine.

use karakuri::blob::BlobParts;
use karakuri::manifest::{
    ActivationScale, CODE_LAYER, Group, LayerShape, Manifest, Packing, Provenance, SamplerKind,
    SamplerShape, TIME_LAYER, TensorKind, WeightFormat, tensor_plan,
};
use karakuri::{Decoder, FramePosition, Model, NumberFormat, Pcg32, Unit, Workspace, limits};

use crate::error::Result;
use crate::network::{Network, Shape};

mod layer;
pub(crate) mod scale;
mod tables;

use layer::{Layer, normal};
use scale::{CODE_FRACTION_BITS, elu_scale, pre_activation_scale};
use tables::{ACTION_COUNT, CLIPS_PER_ACTION, frequencies, intervals, members};

const SEED: u64 = 1;
/// Standard deviation of a code's numbers, in code units.
const CODE_DEVIATION: f64 = (1 << CODE_FRACTION_BITS) as f64;
/// Standard deviation of the stored components.
const COMPONENT_DEVIATION: f64 = 36.0;
/// Frames of the time table, enough for the position that is counted.
const TIME_TABLE_FRAMES: u16 = 16;

/// A blob of the network in the format, with a short time table where the format has one.
///
/// # Errors
/// [`Error::Blob`](crate::Error::Blob) if `core` refuses the shapes.
pub fn synthetic_blob(network: Network, format: NumberFormat, packing: Packing) -> Result<Vec<u8>> {
    let shape = network.shape();
    let manifest = manifest(network, &shape, format, packing);
    let mut random = Pcg32::new(SEED);
    let draw = |index| Layer::draw(&manifest, index, &mut random);
    let layers: Vec<Layer> = (0..manifest.layers.len()).map(draw).collect();
    let mut parts = Parts { shape, manifest, layers, time_table: Vec::new() };
    if format != NumberFormat::F16 {
        let table = time_table(&parts.emit()?)?;
        (parts.time_table, parts.manifest.time_table_shift) = table;
        parts.manifest.time_table_frames = TIME_TABLE_FRAMES;
    }
    parts.emit()
}

/// Everything that goes into a blob.
struct Parts {
    shape: Shape,
    manifest: Manifest<'static>,
    layers: Vec<Layer>,
    time_table: Vec<u8>,
}

impl Parts {
    fn emit(&self) -> Result<Vec<u8>> {
        let mut random = Pcg32::new(SEED + 1);
        let plan: Vec<_> = tensor_plan(&self.manifest).collect();
        let tensors: Vec<(TensorKind, Vec<u8>)> = plan
            .iter()
            .map(|&(kind, length)| (kind, self.tensor(kind, length as usize, &mut random)))
            .collect();
        let tensors: Vec<(TensorKind, &[u8])> =
            tensors.iter().map(|(kind, bytes)| (*kind, bytes.as_slice())).collect();
        let group_names = names("g", self.manifest.group_count);
        let action_names = names("a", ACTION_COUNT);
        let groups = self.shape.groups.iter();
        let groups: Vec<Group<'_>> = groups
            .flat_map(|&(kind, count)| std::iter::repeat_n(kind, count))
            .zip(&group_names)
            .map(|(kind, name)| Group { name, kind, unit: Unit::One })
            .collect();
        let actions: Vec<&str> = action_names.iter().map(String::as_str).collect();
        let parts = BlobParts {
            manifest: &self.manifest,
            groups: &groups,
            actions: &actions,
            joints: &[],
            tensors: &tensors,
        };
        let tensor_bytes: u64 = plan.iter().map(|(_, length)| length + 16).sum();
        let mut blob = vec![0; tensor_bytes as usize + 4096];
        let length = parts.emit(&mut blob)?;
        blob.truncate(length);
        Ok(blob)
    }

    /// Bytes of one tensor; `length` of them.
    fn tensor(&self, kind: TensorKind, length: usize, random: &mut Pcg32) -> Vec<u8> {
        let words = |value: f64| (value.round() as i32).to_le_bytes().repeat(length / 4);
        match kind {
            _ if length == 0 => Vec::new(),
            TensorKind::Frequencies => frequencies(&self.shape),
            TensorKind::ActionCodes => (0..length / 2)
                .flat_map(|_| ((normal(random) * CODE_DEVIATION) as i16).to_le_bytes())
                .collect(),
            TensorKind::Components => (0..length)
                .map(|_| ((normal(random) * COMPONENT_DEVIATION) as i8).cast_unsigned())
                .collect(),
            TensorKind::ComponentSteps => words(256.0 * CODE_DEVIATION / COMPONENT_DEVIATION),
            // Noise of a tenth of the codes' own spread.
            TensorKind::DeviationSteps => words(256.0 * CODE_DEVIATION / 10.0),
            TensorKind::Members => members(),
            TensorKind::Intervals => intervals(),
            TensorKind::Weights(index) => self.layers[index].weights(),
            TensorKind::GroupScales(index) => self.layers[index].group_scales(),
            TensorKind::Bias(index) => self.layers[index].biases(),
            TensorKind::Scales(index) => self.layers[index].scales(self.next_unit(index)),
            TensorKind::TimeTable => self.time_table.clone(),
            // Only of other samplers.
            TensorKind::Deviations | TensorKind::Columns | TensorKind::Lengths => Vec::new(),
        }
    }

    /// Real value of 1 of what the accumulators of a layer become.
    fn next_unit(&self, index: usize) -> f64 {
        match index {
            CODE_LAYER => self.layers[TIME_LAYER].accumulator_scale(),
            _ if index + 1 == self.layers.len() => 1.0 / 65_536.0,
            _ => pre_activation_scale(self.manifest.number_format),
        }
    }
}

/// Products of the time half at whole frames as the device computes them, and their shift.
fn time_table(blob: &[u8]) -> Result<(Vec<u8>, u8)> {
    let model = Model::from_bytes(blob)?;
    let mut workspace = Box::new(Workspace::<{ limits::WIDTH_MAX }>::new());
    let mut decoder = Decoder::new(&model, &mut workspace)?;
    let mut products = Vec::new();
    for frame in 0..u32::from(TIME_TABLE_FRAMES) {
        decoder.time_products(FramePosition::from_frames(frame), |four| products.extend(four));
    }
    let fits = |shift: &u8| products.iter().all(|product| i16::try_from(product >> shift).is_ok());
    let shift = (0..15).find(fits).unwrap_or(15);
    let entry = |product: &i32| ((product >> shift) as i16).to_le_bytes();
    Ok((products.iter().flat_map(entry).collect(), shift))
}

fn manifest(
    network: Network,
    shape: &Shape,
    format: NumberFormat,
    packing: Packing,
) -> Manifest<'static> {
    let layers = shape.layers();
    let last = layers.len() - 1;
    let weights = match format {
        NumberFormat::W8A16 | NumberFormat::W8A8 => WeightFormat::I8,
        NumberFormat::W4A8 => WeightFormat::I4,
        NumberFormat::F16 => WeightFormat::Half,
    };
    let layers = layers.into_iter().enumerate().map(|(index, (input_count, output_count))| {
        let has_elu = index != CODE_LAYER && index != last;
        let activation = if has_elu { elu_scale(format) } else { ActivationScale::NONE };
        LayerShape { input_count, output_count, weights, activation }
    });
    Manifest {
        name: network.name(),
        number_format: format,
        packing,
        rate_millihz: 50_000,
        group_count: shape.groups.iter().map(|&(_, count)| count as u16).sum(),
        action_count: ACTION_COUNT,
        joint_count: 0,
        sequence_code_count: shape.code_counts[0],
        action_code_count: shape.code_counts[1],
        code_fraction_bits: CODE_FRACTION_BITS,
        frequency_count: shape.frequency_count,
        layers: layers.collect(),
        sampler: SamplerShape {
            kind: SamplerKind::ClipCodes,
            component_count: u32::from(ACTION_COUNT * CLIPS_PER_ACTION),
            member_count: u32::from(ACTION_COUNT * CLIPS_PER_ACTION),
            interval_count: ACTION_COUNT,
            step_max_q16: 13_107,
        },
        time_table_frames: 0,
        time_table_shift: 0,
        provenance: Provenance { config_hash: [0; 32], seed: SEED },
    }
}

fn names(prefix: &str, count: u16) -> Vec<String> {
    (0..count).map(|index| format!("{prefix}{index}")).collect()
}

#[cfg(test)]
mod tests {
    use karakuri::Model;

    use super::*;
    use crate::case::Case;
    use crate::host::decode_cases;

    const NETWORKS: [Network; 3] = [Network::Paper, Network::Small, Network::Tiny];

    #[test]
    fn every_network_is_a_model_in_every_format_and_packing() {
        for format in NumberFormat::ALL {
            for (network, packing) in NETWORKS.into_iter().zip([Packing::Rows, Packing::Tiles]) {
                let blob = synthetic_blob(network, format, packing).unwrap();
                let model = Model::from_bytes(&blob).unwrap();
                assert_eq!(model.channel_count(), usize::from(network.shape().channel_count()));
            }
        }
    }

    #[test]
    fn poses_move_and_stay_in_range() {
        let case = Case {
            action: 3,
            pose_count: 20,
            frames: 50,
            seed: 1,
            first_bits: 0,
            step_bits: 1 << 17,
        };
        for format in NumberFormat::ALL {
            let blob = synthetic_blob(Network::Tiny, format, Packing::Tiles).unwrap();
            let poses = decode_cases(&Model::from_bytes(&blob).unwrap(), &[case]).unwrap();
            for channel in 0..11 {
                let values = || poses.iter().map(|pose| f64::from(pose[channel]) / 65_536.0);
                let (min, max) = (values().fold(9.0, f64::min), values().fold(-9.0, f64::max));
                assert!(max - min > 0.05 && max < 5.0 && min > -5.0, "{format:?}: {min} to {max}");
            }
        }
    }
}
