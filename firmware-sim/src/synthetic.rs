//! Models of given shapes with weights from a generator: what is to be counted needs no training.
//!
//! In:  a [`Network`] and a number format.
//! Out: bytes of a blob.
//!
//! Why here: counts depend on shapes, formats and, a little, on the signs of pre-activations. Weights are drawn with the
//! spread that keeps activations in a trained network's range; see `layer.rs`. Only sums, products and square roots, so
//! the same bytes come out on every machine.

use karakuri::blob::BlobParts;
use karakuri::manifest::{
    Group, LayerShape, Manifest, Packing, Provenance, SamplerKind, SamplerShape, TensorKind,
    tensor_plan,
};
use karakuri::{NumberFormat, Pcg32, Unit};

use crate::error::Result;
use crate::network::{Network, Shape};

mod layer;

use layer::{CODE_FRACTION_BITS, Layer, normal};

const ACTION_COUNT: u16 = 12;
const CLIPS_PER_ACTION: u16 = 8;
const SEED: u64 = 1;
/// Turns per frame · 2^32 of the fastest frequency: 1 rad.
const FIRST_FREQUENCY: f64 = 683_565_275.576;
/// Standard deviation of a code's numbers, in code units.
const CODE_DEVIATION: f64 = (1 << CODE_FRACTION_BITS) as f64;

/// A blob of the network in the format.
///
/// # Errors
/// [`Error::Blob`](crate::Error::Blob) if `core` refuses the shapes.
pub fn synthetic_blob(network: Network, format: NumberFormat) -> Result<Vec<u8>> {
    let shape = network.shape();
    let manifest = manifest(network, &shape, format);
    let mut random = Pcg32::new(SEED);
    let plan: Vec<_> = tensor_plan(&manifest).collect();
    let layers: Vec<Layer> = (0..manifest.layers.len())
        .map(|index| Layer::draw(&manifest, index, &mut random))
        .collect();
    let tensors: Vec<(TensorKind, Vec<u8>)> = plan
        .iter()
        .map(|&(kind, length)| (kind, tensor(kind, length as usize, &shape, &layers, &mut random)))
        .collect();
    let tensors: Vec<(TensorKind, &[u8])> =
        tensors.iter().map(|(kind, bytes)| (*kind, bytes.as_slice())).collect();
    let (group_names, action_names) = (names("g", manifest.group_count), names("a", ACTION_COUNT));
    let kinds = shape.groups.iter().flat_map(|&(kind, count)| std::iter::repeat_n(kind, count));
    let groups: Vec<Group<'_>> =
        kinds.zip(&group_names).map(|(kind, name)| Group { name, kind, unit: Unit::One }).collect();
    let actions: Vec<&str> = action_names.iter().map(String::as_str).collect();
    let parts = BlobParts {
        manifest: &manifest,
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

fn manifest(network: Network, shape: &Shape, format: NumberFormat) -> Manifest<'static> {
    let layers = shape.layers();
    let last = layers.len() - 1;
    let layers = layers.into_iter().enumerate().map(|(index, (input_count, output_count))| {
        let activation = layer::activation_of(index, last, format);
        LayerShape { input_count, output_count, activation }
    });
    Manifest {
        name: network.name(),
        number_format: format,
        packing: Packing::RowMajor,
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
        provenance: Provenance { config_hash: [0; 32], seed: SEED },
    }
}

/// Bytes of one tensor; `length` of them.
fn tensor(
    kind: TensorKind,
    length: usize,
    shape: &Shape,
    layers: &[Layer],
    random: &mut Pcg32,
) -> Vec<u8> {
    let words = |value: f64| (value.round() as i32).to_le_bytes().repeat(length / 4);
    match kind {
        TensorKind::Frequencies => frequencies(shape),
        TensorKind::ActionCodes => (0..length / 2)
            .flat_map(|_| ((normal(random) * CODE_DEVIATION) as i16).to_le_bytes())
            .collect(),
        TensorKind::Components => {
            (0..length).map(|_| ((normal(random) * 36.0) as i8).cast_unsigned()).collect()
        }
        // Code units · 2^8 per 1 of a component, whose standard deviation is 36.
        TensorKind::ComponentSteps => words(256.0 * CODE_DEVIATION / 36.0),
        TensorKind::DeviationSteps => words(256.0 * CODE_DEVIATION / 10.0),
        TensorKind::Deviations => Vec::new(),
        TensorKind::Members => members(),
        TensorKind::Intervals => intervals(),
        TensorKind::Weights(index) => layers[index].weights(),
        TensorKind::Bias(index) => layers[index].biases(),
        TensorKind::Multipliers(index) => layers[index].multipliers(length / 4),
        TensorKind::Shifts(index) => layers[index].shifts(length),
    }
}

fn frequencies(shape: &Shape) -> Vec<u8> {
    let steps =
        std::iter::successors(Some(FIRST_FREQUENCY), |step| Some(step * shape.frequency_ratio));
    steps
        .take(usize::from(shape.frequency_count))
        .flat_map(|step| (step as u32).to_le_bytes())
        .collect()
}

/// Every component once, in order, equally likely within its interval.
fn members() -> Vec<u8> {
    let member = |component: u16| {
        let place = u32::from(component % CLIPS_PER_ACTION) + 1;
        let cumulative = (65_535 * place / u32::from(CLIPS_PER_ACTION)) as u16;
        [component, cumulative].map(u16::to_le_bytes).concat()
    };
    (0..ACTION_COUNT * CLIPS_PER_ACTION).flat_map(member).collect()
}

/// One interval an action: 40 to 60 frames, its own clips, noise as it is (4096 is 1).
fn intervals() -> Vec<u8> {
    let interval = |action: u16| {
        let halves = [action, 40, 60, 4096].map(u16::to_le_bytes).concat();
        let first = u32::from(action * CLIPS_PER_ACTION);
        [halves, [first, u32::from(CLIPS_PER_ACTION)].map(u32::to_le_bytes).concat()].concat()
    };
    (0..ACTION_COUNT).flat_map(interval).collect()
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
    fn every_network_is_a_model_in_every_format() {
        for format in NumberFormat::ALL {
            for network in NETWORKS {
                let blob = synthetic_blob(network, format).unwrap();
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
            let blob = synthetic_blob(Network::Tiny, format).unwrap();
            let poses = decode_cases(&Model::from_bytes(&blob).unwrap(), &[case]).unwrap();
            for channel in 0..11 {
                let values = || poses.iter().map(|pose| f64::from(pose[channel]) / 65_536.0);
                let (min, max) = (values().fold(9.0, f64::min), values().fold(-9.0, f64::max));
                assert!(max - min > 0.05 && max < 5.0 && min > -5.0, "{format:?}: {min} to {max}");
            }
        }
    }
}
