//! A small model made twice, for tests: as a checkpoint folder and as a blob.
//!
//! Why here: the simulator may not use the trainer, so its tests quantize by hand. All weights are multiples of 2^-6
//! within ±1, which i8 and binary16 hold exactly; what remains is the error of activations and arithmetic.

mod units;

use std::collections::HashMap;
use std::fs;

use karakuri::blob::BlobParts;
use karakuri::manifest::{
    ActivationScale, Group, LayerShape, Manifest, Packing, Provenance, SamplerKind, SamplerShape,
    TensorKind, WeightFormat,
};
use karakuri::packing::ByteLayout;
use karakuri::{GroupKind, NumberFormat, Pcg32, Requantizer, Unit};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use tempfile::TempDir;

use crate::fixture::units::{Units, accumulator_unit, activation, pre_activation_unit};
use crate::synthetic::scale::word_of;

const SEQUENCE: usize = 3;
const ACTION: usize = 2;
const PAIRS: usize = 4;
/// Outputs of every layer.
const WIDTHS: [usize; 4] = [24, 16, 12, 10];
const ACTIONS: [&str; 2] = ["bow", "write"];
const CLIP_FRAMES: [usize; 4] = [30, 60, 41, 90];
const GROUPS: [(&str, GroupKind, Unit); 3] = [
    ("neck", GroupKind::Scalar, Unit::Degree),
    ("body", GroupKind::Translation, Unit::Millimetre),
    ("head", GroupKind::Rotation6d, Unit::One),
];
const WEIGHT_UNIT: f64 = 1.0 / 64.0;
const CODE_FRACTION_BITS: u8 = 12;

/// One layer, weights in units of `WEIGHT_UNIT`.
struct Layer {
    input_count: usize,
    /// // (out, in)
    weights: Vec<i8>,
    /// // (out)
    bias: Vec<f64>,
}

/// The model before it is written in either form.
pub struct Fixture {
    layers: Vec<Layer>,
    /// // (clip, dimension), multiples of 2^-6
    sequence_codes: Vec<f64>,
    /// // (action, dimension), multiples of 2^-6
    action_codes: Vec<f64>,
    mean: Vec<f64>,
    scale: Vec<f64>,
    /// SHA-256 of a configuration.
    pub config_hash: [u8; 32],
}

impl Fixture {
    /// The same model for the same seed.
    pub fn new(seed: u64) -> Self {
        let mut rng = Pcg32::new(seed);
        let mut small =
            move |bound: i32| ((rng.next_u32() >> 8) as i32).rem_euclid(2 * bound + 1) - bound;
        let mut inputs = SEQUENCE + ACTION + 2 * PAIRS;
        let layers = WIDTHS.map(|outputs| {
            let weights = (0..outputs * inputs).map(|_| small(24) as i8).collect();
            let bias = (0..outputs).map(|_| f64::from(small(32)) * WEIGHT_UNIT).collect();
            let layer = Layer { input_count: inputs, weights, bias };
            inputs = outputs;
            layer
        });
        let mut codes =
            |count: usize| (0..count).map(|_| f64::from(small(64)) * WEIGHT_UNIT).collect();
        Self {
            layers: layers.into(),
            sequence_codes: codes(CLIP_FRAMES.len() * SEQUENCE),
            action_codes: codes(ACTIONS.len() * ACTION),
            mean: (0..WIDTHS[3]).map(|channel| channel as f64).collect(),
            scale: (0..WIDTHS[3]).map(|channel| 0.5 + channel as f64 / 8.0).collect(),
            config_hash: [0xa5; 32],
        }
    }

    fn frequencies_rad() -> impl Iterator<Item = f64> {
        (0..PAIRS).map(|pair| 0.5_f64.powi(pair as i32 + 2))
    }

    /// A run folder as `host-trainer` writes it.
    pub fn run(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("checkpoint.safetensors"), self.checkpoint()).unwrap();
        folder
    }

    /// The bytes of the checkpoint file.
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
        let f32s = |values: &mut dyn Iterator<Item = f64>| {
            values.flat_map(|value| (value as f32).to_le_bytes()).collect()
        };
        for (index, layer) in self.layers.iter().enumerate() {
            let mut weights = layer.weights.iter().map(|&weight| f64::from(weight) * WEIGHT_UNIT);
            let shape = vec![layer.bias.len(), layer.input_count];
            tensors.push((
                format!("decoder.{index}.weight"),
                Dtype::F32,
                shape,
                f32s(&mut weights),
            ));
            let bias = f32s(&mut layer.bias.iter().copied());
            tensors.push((
                format!("decoder.{index}.bias"),
                Dtype::F32,
                vec![layer.bias.len()],
                bias,
            ));
        }
        let mut codes = |name: &str, values: &[f64], columns: usize| {
            let shape = vec![values.len() / columns, columns];
            tensors.push((name.to_owned(), Dtype::F32, shape, f32s(&mut values.iter().copied())));
        };
        codes("sequence_code.mean", &self.sequence_codes, SEQUENCE);
        codes("action_code.mean", &self.action_codes, ACTION);
        let frequencies = Self::frequencies_rad().flat_map(f64::to_le_bytes).collect();
        tensors.push(("frequencies_rad".to_owned(), Dtype::F64, vec![PAIRS], frequencies));
        let views = tensors.iter().map(|(name, dtype, shape, data)| {
            (name, TensorView::new(*dtype, shape.clone(), data).unwrap())
        });
        safetensors::serialize(views, Some(self.metadata())).unwrap()
    }

    fn metadata(&self) -> HashMap<String, String> {
        let groups: Vec<_> = GROUPS
            .iter()
            .map(|(name, kind, unit)| serde_json::json!({"name": name, "kind": kind, "unit": unit}))
            .collect();
        let clip = |(index, frame_count)| {
            let (name, action) = (format!("clip{index}"), index / 2);
            serde_json::json!({"name": name, "action": action, "frame_count": frame_count})
        };
        let dataset = serde_json::json!({
            "layout": {"groups": groups}, "rate_hz": 50.0, "actions": ACTIONS, "skeleton": null,
            "clips": CLIP_FRAMES.iter().enumerate().map(clip).collect::<Vec<_>>(),
            "mean": self.mean, "scale": self.scale,
        });
        let hash: String = self.config_hash.iter().map(|byte| format!("{byte:02x}")).collect();
        let state = serde_json::json!({"config_hash": hash, "step": 7});
        [("dataset", dataset), ("state", state)]
            .map(|(key, value)| (key.to_owned(), value.to_string()))
            .into()
    }
}

impl Fixture {
    /// The bytes of the blob in `format`.
    pub fn blob(&self, format: NumberFormat) -> Vec<u8> {
        let mut tensors = self.tables();
        let mut layers = Vec::new();
        for (index, layer) in self.device_layers().iter().enumerate() {
            layers.push(shape(index, layer, format));
            layer_tensors(&mut tensors, index, layer, format);
        }
        let manifest = Manifest {
            provenance: Provenance { config_hash: self.config_hash, seed: 1 },
            ..manifest(format, &layers)
        };
        let groups = GROUPS.map(|(name, kind, unit)| Group { name, kind, unit });
        let tensors: Vec<_> =
            tensors.iter().map(|(kind, bytes)| (*kind, bytes.as_slice())).collect();
        let parts = BlobParts {
            manifest: &manifest,
            groups: &groups,
            actions: &ACTIONS,
            joints: &[],
            tensors: &tensors,
        };
        let mut blob = vec![0; 64 * 1024];
        let length = parts.emit(&mut blob).unwrap();
        blob.truncate(length);
        blob
    }

    /// Layer 1 in two halves, and the standardisation folded into the last layer.
    fn device_layers(&self) -> Vec<DeviceLayer<'_>> {
        let rows = |layer: &'_ Layer| layer.bias.len();
        let code_count = SEQUENCE + ACTION;
        let first = &self.layers[0];
        let whole = |layer: &'_ Layer| (0, layer.input_count);
        let halves = [(first, (0, code_count), true), (first, (code_count, 2 * PAIRS), false)];
        let rest = self.layers[1..].iter().map(|layer| (layer, whole(layer), true));
        let last = self.layers.len();
        halves
            .into_iter()
            .chain(rest)
            .enumerate()
            .map(|(index, (layer, (start, input_count), has_bias))| {
                let is_last = index == last;
                DeviceLayer {
                    layer,
                    start,
                    input_count,
                    has_bias,
                    scale: if is_last { self.scale.clone() } else { vec![1.0; rows(layer)] },
                    mean: if is_last { self.mean.clone() } else { vec![0.0; rows(layer)] },
                    is_last,
                }
            })
            .collect()
    }

    /// Time embedding and sampler: every clip is a component of its action's one interval.
    fn tables(&self) -> Vec<(TensorKind, Vec<u8>)> {
        let turns =
            |radians: f64| (radians / std::f64::consts::TAU * 4_294_967_296.0).round() as u32;
        let code = |value: &f64| (value * f64::from(1 << CODE_FRACTION_BITS)) as i16;
        // Components count 2^-6, the unit of the codes; steps are in code units · 2^8.
        let component = |value: &f64| (value / WEIGHT_UNIT) as i8 as u8;
        let step = (WEIGHT_UNIT * f64::from(1 << (CODE_FRACTION_BITS + 8))) as i32;
        let interval = |(action, frames): (usize, &[usize])| {
            let halves = [action, frames[0].min(frames[1]), frames[0].max(frames[1]), 1 << 12];
            let words = [2 * action as u32, 2];
            let halves = halves.into_iter().flat_map(|half| (half as u16).to_le_bytes());
            halves.chain(words.into_iter().flat_map(u32::to_le_bytes)).collect::<Vec<_>>()
        };
        vec![
            (
                TensorKind::Frequencies,
                Self::frequencies_rad().flat_map(|f| turns(f).to_le_bytes()).collect(),
            ),
            (
                TensorKind::ActionCodes,
                self.action_codes.iter().flat_map(|v| code(v).to_le_bytes()).collect(),
            ),
            (TensorKind::Components, self.sequence_codes.iter().map(component).collect()),
            (TensorKind::DeviationSteps, [40 << 8; SEQUENCE].map(i32::to_le_bytes).concat()),
            (
                TensorKind::ComponentSteps,
                [step; SEQUENCE].into_iter().flat_map(i32::to_le_bytes).collect(),
            ),
            (
                TensorKind::Members,
                (0..4u16).flat_map(|clip| [clip, u16::MAX]).flat_map(u16::to_le_bytes).collect(),
            ),
            (TensorKind::Intervals, CLIP_FRAMES.chunks(2).enumerate().flat_map(interval).collect()),
        ]
    }
}

/// One layer as the device sees it.
struct DeviceLayer<'a> {
    layer: &'a Layer,
    /// First input that belongs to it.
    start: usize,
    input_count: usize,
    has_bias: bool,
    scale: Vec<f64>,
    mean: Vec<f64>,
    is_last: bool,
}

fn layer_tensors(
    tensors: &mut Vec<(TensorKind, Vec<u8>)>,
    index: usize,
    device: &DeviceLayer<'_>,
    format: NumberFormat,
) {
    let units = Units::of(format);
    let bytes = index > 0 && format.activation_range().1 == 127;
    // Stored inputs; of what the accumulator's unit becomes.
    let (input_unit, output_unit) = match index {
        0 => (units.code, accumulator_unit(1, units.sinusoid, format)),
        1 => (units.sinusoid, pre_activation_unit(format)),
        _ => (units.activation, pre_activation_unit(format)),
    };
    let output_unit = if device.is_last { 1.0 / 65_536.0 } else { output_unit };
    let accumulator_unit = accumulator_unit(index, input_unit, format);
    let (mut weights, mut bias, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let rows = device.layer.weights.chunks_exact(device.layer.input_count);
    let rows: Vec<&[i8]> = rows.map(|row| &row[device.start..][..device.input_count]).collect();
    for (row_index, row) in rows.iter().enumerate() {
        let (scale, mean) = (device.scale[row_index], device.mean[row_index]);
        let real_bias = device.layer.bias[row_index];
        if format == NumberFormat::F16 {
            bias.extend(((real_bias * scale + mean) as f32).to_le_bytes());
            continue;
        }
        weights.extend(row.iter().copied());
        let stored_bias = (real_bias + mean / scale) / accumulator_unit;
        bias.extend((stored_bias.round() as i32).to_le_bytes());
        scales.extend(word_of(accumulator_unit * scale / output_unit).to_le_bytes());
    }
    let shape = shape(index, device, format);
    let filling = shape.rows_filled() - rows.len();
    bias.extend(vec![0; 4 * filling]);
    let packed = if format == NumberFormat::F16 {
        pack_half(&rows, &device.scale)
    } else {
        let mut packed = vec![0; shape.rows_filled() / 4 * shape.block_bytes()];
        ByteLayout::new(Packing::Tiles, bytes).pack(&shape, &weights, &mut packed);
        scales.extend(Requantizer::TINY.to_bits().to_le_bytes().repeat(filling));
        packed
    };
    tensors.push((TensorKind::Weights(index), packed));
    if device.has_bias {
        tensors.push((TensorKind::Bias(index), bias));
    }
    tensors.push((TensorKind::Scales(index), scales));
}

/// Blocks of four rows, a column's four weights together.
fn pack_half(rows: &[&[i8]], scale: &[f64]) -> Vec<u8> {
    let weight = |row: usize, column: usize| {
        rows.get(row).map_or(0.0, |weights| f64::from(weights[column]) * WEIGHT_UNIT * scale[row])
    };
    let columns = rows[0].len();
    let blocks = (0..rows.len()).step_by(4);
    let fours = blocks.flat_map(|block| (0..columns).map(move |column| (block, column)));
    let four = |(block, column)| (block..block + 4).map(move |row| weight(row, column));
    fours.flat_map(four).flat_map(|weight| half::f16::from_f64(weight).to_le_bytes()).collect()
}

fn shape(index: usize, device: &DeviceLayer<'_>, format: NumberFormat) -> LayerShape {
    let has_activation = index > 0 && !device.is_last;
    LayerShape {
        input_count: device.input_count as u16,
        output_count: device.layer.bias.len() as u16,
        weights: if format == NumberFormat::F16 { WeightFormat::Half } else { WeightFormat::I8 },
        activation: if has_activation { activation(format) } else { ActivationScale::NONE },
    }
}

fn manifest(format: NumberFormat, layers: &[LayerShape]) -> Manifest<'static> {
    Manifest {
        name: "fixture",
        number_format: format,
        packing: Packing::Tiles,
        rate_millihz: 50_000,
        group_count: GROUPS.len() as u16,
        action_count: ACTIONS.len() as u16,
        joint_count: 0,
        sequence_code_count: SEQUENCE as u16,
        action_code_count: ACTION as u16,
        code_fraction_bits: CODE_FRACTION_BITS,
        frequency_count: PAIRS as u16,
        layers: layers.iter().copied().collect(),
        sampler: SamplerShape {
            kind: SamplerKind::ClipCodes,
            component_count: CLIP_FRAMES.len() as u32,
            member_count: CLIP_FRAMES.len() as u32,
            interval_count: ACTIONS.len() as u16,
            step_max_q16: 1 << 14,
        },
        time_table_frames: 0,
        time_table_shift: 0,
        provenance: Provenance { config_hash: [0; 32], seed: 0 },
    }
}
