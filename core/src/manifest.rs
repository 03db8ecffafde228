//! What a blob says about itself: the manifest, the names, and which tensors follow.
//!
//! In:  postcard bytes, through `blob.rs`.
//! Out: shapes to `model.rs`; the plan of tensors to both reader and writer.
//!
//! Why here: the plan follows from the manifest, so no table of contents can disagree with it.

use serde::Serialize;

pub use crate::code_half::GATE_MAX;
use crate::limits::LAYERS_MAX;
use crate::pose_layout::{GroupKind, Unit};
pub use crate::sampler_shape::{SamplerKind, SamplerShape};

/// How weights and activations are stored and multiplied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum NumberFormat {
    /// i8 weights with one scale a row, i16 activations, i32 accumulator.
    W8A16,
    /// i8 weights with one scale a row, i8 activations with a zero point, i32 accumulator.
    W8A8,
    /// 4-bit weights with a scale per row and 64 columns, or i8 weights, as each layer says; the rest as `W8A8`.
    W4A8,
    /// IEEE binary16 weights, f32 activations and accumulator; needs the feature `f16`.
    F16,
}

impl NumberFormat {
    /// Every format.
    pub const ALL: [Self; 4] = [Self::W8A16, Self::W8A8, Self::W4A8, Self::F16];

    /// The name in commands and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::W8A16 => "w8a16",
            Self::W8A8 => "w8a8",
            Self::W4A8 => "w4a8",
            Self::F16 => "f16",
        }
    }

    /// Whether this build of the crate can decode the format.
    pub const fn is_built(self) -> bool {
        match self {
            Self::W8A16 => cfg!(feature = "w8a16"),
            Self::W8A8 => cfg!(feature = "w8a8"),
            Self::W4A8 => cfg!(feature = "w4a8"),
            Self::F16 => cfg!(feature = "f16"),
        }
    }

    /// Smallest and largest stored activation of the integer formats.
    pub const fn activation_range(self) -> (i16, i16) {
        match self {
            Self::W8A8 | Self::W4A8 => (-127, 127),
            Self::W8A16 | Self::F16 => (-32_767, 32_767),
        }
    }

    /// The stored value of a sinusoid that is 1.
    pub const fn sinusoid_one(self) -> i16 {
        self.activation_range().1
    }

    /// What the weights of a layer may be.
    pub const fn allows(self, weights: WeightFormat) -> bool {
        match weights {
            WeightFormat::I8 => !matches!(self, Self::F16),
            WeightFormat::I4 => matches!(self, Self::W4A8),
            WeightFormat::Half => matches!(self, Self::F16),
        }
    }
}

/// How the weights of one layer are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum WeightFormat {
    /// i8 with one scale a row.
    I8,
    /// 4 bits with a scale per row and 64 columns; see `kernel::portable::w4a8`.
    I4,
    /// IEEE binary16.
    Half,
}

/// In which order 8-bit weights lie; 4-bit and binary16 ones have one order only, see `packing.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum Packing {
    /// Row after row: for vector units (Cortex-M55) and hosts. The assembly kernels refuse it.
    Rows,
    /// Tiles of four rows by four columns: for the assembly kernels. Everyone reads it.
    Tiles,
}

impl Packing {
    /// The name in commands and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rows => "rows",
            Self::Tiles => "tiles",
        }
    }
}

/// The first description: everything of fixed size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Manifest<'a> {
    /// Free text: what the model was trained on.
    pub name: &'a str,
    /// How weights and activations are stored.
    pub number_format: NumberFormat,
    /// Order of 8-bit weights.
    pub packing: Packing,
    /// Poses per 1000 s.
    pub rate_millihz: u32,
    /// Groups of the layout.
    pub group_count: u16,
    /// Actions.
    pub action_count: u16,
    /// Joints of the skeleton, 0 when there is none.
    pub joint_count: u16,
    /// Numbers of a sequence code β.
    pub sequence_code_count: u16,
    /// Numbers of an action code α.
    pub action_code_count: u16,
    /// Fraction bits of the numbers of a code.
    pub code_fraction_bits: u8,
    /// Frequencies of the time embedding; two sinusoids each.
    pub frequency_count: u16,
    /// Code half of layer 1, time half of layer 1, then every further layer.
    pub layers: heapless::Vec<LayerShape, LAYERS_MAX>,
    /// How codes are drawn.
    pub sampler: SamplerShape,
    /// Whole frames whose time half is in the blob; 0 is none.
    pub time_table_frames: u16,
    /// Entries of the time table are accumulators / 2^this.
    pub time_table_shift: u8,
    /// Where the model comes from.
    pub provenance: Provenance,
}

/// Size of one layer and the scale of what it hands on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LayerShape {
    /// Inputs.
    pub input_count: u16,
    /// Outputs.
    pub output_count: u16,
    /// How the weights are stored.
    pub weights: WeightFormat,
    /// Integer formats, layers with an ELU: pre-activation → stored activation.
    pub activation: ActivationScale,
}

/// How the ELU of a layer is computed; [`NONE`](Self::NONE) where a layer has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ActivationScale {
    /// Octaves (powers of 1/e in base 2) per unit of the pre-activation, Q5.27, at least 1.
    pub power_step: u32,
    /// Real 1 in stored units: `one / 2^(one_shift − 16)`, below 2^15.
    pub one: u16,
    /// See `one`; at most 30.
    pub one_shift: u8,
    /// Stored activation of real 0.
    pub zero_point: i16,
    /// A unit of the pre-activation is a stored unit / 2^this; at most 8.
    pub fraction_bits: u8,
}

impl Manifest<'_> {
    /// Of nothing: what the reader fills in.
    pub(crate) fn empty() -> Self {
        Self {
            name: "",
            number_format: NumberFormat::W8A16,
            packing: Packing::Rows,
            rate_millihz: 0,
            group_count: 0,
            action_count: 0,
            joint_count: 0,
            sequence_code_count: 0,
            action_code_count: 0,
            code_fraction_bits: 0,
            frequency_count: 0,
            layers: heapless::Vec::new(),
            sampler: SamplerShape {
                kind: SamplerKind::ClipCodes,
                component_count: 0,
                member_count: 0,
                interval_count: 0,
                step_max_q16: 0,
            },
            time_table_frames: 0,
            time_table_shift: 0,
            provenance: Provenance { config_hash: [0; 32], seed: 0 },
        }
    }
}

impl ActivationScale {
    /// Of a layer without an ELU.
    pub const NONE: Self =
        Self { power_step: 1, one: 0, one_shift: 0, zero_point: 0, fraction_bits: 0 };
}

/// What makes a model reproducible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Provenance {
    /// SHA-256 of the training configuration.
    pub config_hash: [u8; 32],
    /// Seed of the training.
    pub seed: u64,
}

/// One group of channels, as stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Group<'a> {
    /// Unique name: a joint or a servo.
    pub name: &'a str,
    /// What the channels are.
    pub kind: GroupKind,
    /// Unit of every channel of the group.
    pub unit: Unit,
}

/// One joint of the skeleton, as stored; parents precede children.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Joint<'a> {
    /// Unique name.
    pub name: &'a str,
    /// Index of the parent; `None` for the root.
    pub parent: Option<u16>,
    /// Offset from the parent at rest, in the unit of the layout's translation.
    pub offset: [f32; 3],
}

/// What a tensor holds; layers are counted as in [`Manifest::layers`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorKind {
    /// Turns per frame · 2^32, u32. // (frequency)
    Frequencies,
    /// i16 in the code format. // (action, action code)
    ActionCodes,
    /// i8, in units of the component steps. // (component, sequence code)
    ///
    /// `NearestClips`: unsigned numbers of as many bits as their columns say, the lowest bits first; every row fills
    /// whole bytes. Clips are in order of action, then of length.
    Components,
    /// i32: code units · 2^8 per 1 of a component. // (sequence code)
    ComponentSteps,
    /// `NearestClips` only: value of 0 in code units i16, bits u8 (0..=8), zero u8. // (sequence code)
    Columns,
    /// u8, in units of the deviation steps; `DiagonalMixture` only. // (component, sequence code)
    Deviations,
    /// i32: code units · 2^8. Clips: σ of the noise; `DiagonalMixture`: per 1 of a deviation. // (sequence code)
    DeviationSteps,
    /// Pairs of u16: component, cumulative weight (65,535 at an interval's last member). // (member, 2)
    Members,
    /// `NearestClips` only: frames of every clip, u16. // (component)
    Lengths,
    /// action u16, frames min u16, frames max u16, spread u16 (Q4.12: factor on the noise of clips),
    /// first member u32, members u32. // (interval)
    ///
    /// `NearestClips`: members are components.
    Intervals,
    /// Packed, see `packing.rs`. // (out, in)
    Weights(usize),
    /// u16, 4-bit weights only. // (block of 4 rows, group of 64 columns, row)
    GroupScales(usize),
    /// i32 in accumulator units, or f32; none for the time half; rows filled up to a multiple of 4. // (out)
    Bias(usize),
    /// Words of `Requantizer`, integer formats only; rows filled up to a multiple of 4. // (out)
    Scales(usize),
    /// i16, in accumulator units of the time half / 2^time_table_shift. // (frame, out)
    TimeTable,
}

impl TensorKind {
    /// The part of the model that the tensor belongs to, for reports.
    pub const fn part(self) -> &'static str {
        match self {
            Self::Frequencies => "time embedding",
            Self::ActionCodes => "action codes",
            Self::Components | Self::ComponentSteps | Self::Columns => "sampler means",
            Self::Deviations | Self::DeviationSteps => "sampler deviations",
            Self::Members | Self::Lengths | Self::Intervals => "sampler intervals",
            Self::Weights(_) => "weights",
            Self::Bias(_) => "biases",
            Self::Scales(_) | Self::GroupScales(_) => "scales",
            Self::TimeTable => "time table",
        }
    }
}

/// Bytes of one interval record.
pub(crate) const INTERVAL_BYTES: usize = 16;
/// Bytes of one column record.
pub(crate) const COLUMN_BYTES: usize = 4;
/// Bytes of one member record.
pub(crate) const MEMBER_BYTES: usize = 4;
/// Index of the code half of layer 1 in [`Manifest::layers`].
pub const CODE_LAYER: usize = 0;
/// Index of the time half of layer 1 in [`Manifest::layers`].
pub const TIME_LAYER: usize = 1;

/// Tensors before those of the layers.
const TABLES: usize = 10;

/// All tensors in file order with their lengths in bytes; 64 bits, so that no manifest can overflow them.
pub fn tensor_plan(manifest: &Manifest<'_>) -> impl Iterator<Item = (TensorKind, u64)> {
    (0..TABLES + 4 * manifest.layers.len() + 1).map(|index| tensor_at(manifest, index))
}

fn tensor_at(manifest: &Manifest<'_>, index: usize) -> (TensorKind, u64) {
    let sampler = &manifest.sampler;
    let code_count = u64::from(manifest.sequence_code_count);
    let component_count = u64::from(sampler.component_count);
    let component_numbers = component_count * code_count;
    let [component_bytes, column_bytes, deviation_bytes, length_bytes] = match sampler.kind {
        SamplerKind::ClipCodes => [component_numbers, 0, 0, 0],
        SamplerKind::DiagonalMixture => [component_numbers, 0, component_numbers, 0],
        SamplerKind::NearestClips { row_bytes, .. } => [
            component_count * u64::from(row_bytes),
            COLUMN_BYTES as u64 * code_count,
            0,
            2 * component_count,
        ],
    };
    match index {
        0 => (TensorKind::Frequencies, 4 * u64::from(manifest.frequency_count)),
        1 => (
            TensorKind::ActionCodes,
            2 * u64::from(manifest.action_count) * u64::from(manifest.action_code_count),
        ),
        2 => (TensorKind::Components, component_bytes),
        3 => (TensorKind::ComponentSteps, 4 * code_count),
        4 => (TensorKind::Columns, column_bytes),
        5 => (TensorKind::Deviations, deviation_bytes),
        6 => (TensorKind::DeviationSteps, 4 * code_count),
        7 => (TensorKind::Members, MEMBER_BYTES as u64 * u64::from(sampler.member_count)),
        8 => (TensorKind::Lengths, length_bytes),
        9 => (TensorKind::Intervals, INTERVAL_BYTES as u64 * u64::from(sampler.interval_count)),
        _ => layer_tensor_at(manifest, index - TABLES),
    }
}

fn layer_tensor_at(manifest: &Manifest<'_>, place: usize) -> (TensorKind, u64) {
    let index = place / 4;
    let Some(shape) = manifest.layers.get(index) else {
        let rows = manifest.layers.get(TIME_LAYER).map_or(0, LayerShape::rows_filled);
        return (TensorKind::TimeTable, 2 * u64::from(manifest.time_table_frames) * rows as u64);
    };
    let [weights, group_scales, bias, scales] =
        shape.tensor_bytes(index, manifest.number_format).map(|bytes| bytes as u64);
    match place % 4 {
        0 => (TensorKind::Weights(index), weights),
        1 => (TensorKind::GroupScales(index), group_scales),
        2 => (TensorKind::Bias(index), bias),
        _ => (TensorKind::Scales(index), scales),
    }
}
