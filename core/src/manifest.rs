//! What a blob says about itself: the manifest, the names, and which tensors follow.
//!
//! In:  postcard bytes, through `blob.rs`.
//! Out: shapes to `model.rs`; the plan of tensors to both reader and writer.
//!
//! Why here: the plan follows from the manifest, so no table of contents can disagree with it.

use serde::{Deserialize, Serialize};

use crate::limits::LAYERS_MAX;
use crate::pose_layout::{GroupKind, Unit};

/// How weights and activations are stored and multiplied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum NumberFormat {
    /// i8 weights with one scale a row, i16 activations, i32 accumulator.
    W8A16,
    /// i8 weights with one scale a row, i8 activations with a zero point, i32 accumulator.
    W8A8,
    /// IEEE binary16 weights, f32 activations and accumulator; needs the feature `f16`.
    F16,
}

impl NumberFormat {
    /// Every format.
    pub const ALL: [Self; 3] = [Self::W8A16, Self::W8A8, Self::F16];

    /// The name in commands and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::W8A16 => "w8a16",
            Self::W8A8 => "w8a8",
            Self::F16 => "f16",
        }
    }

    /// Smallest and largest stored activation of the integer formats.
    pub const fn activation_range(self) -> (i16, i16) {
        match self {
            Self::W8A8 => (-128, 127),
            Self::W8A16 | Self::F16 => (-32_767, 32_767),
        }
    }

    /// The stored value of a sinusoid that is 1.
    pub const fn sinusoid_one(self) -> i16 {
        match self {
            Self::W8A8 => 127,
            Self::W8A16 | Self::F16 => 32_767,
        }
    }

    /// Bytes of one weight.
    pub const fn weight_bytes(self) -> usize {
        match self {
            Self::W8A16 | Self::W8A8 => 1,
            Self::F16 => 2,
        }
    }
}

/// In which order a layer's weights lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Packing {
    /// (out, in), row after row.
    RowMajor,
}

/// How the codes of a motion are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SamplerKind {
    /// A training clip's own code, moved towards a neighbour's, plus noise of one shared σ.
    ClipCodes,
    /// A Gaussian mixture with diagonal covariances.
    DiagonalMixture,
}

/// The first description: everything of fixed size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest<'a> {
    /// Free text: what the model was trained on.
    pub name: &'a str,
    /// How weights and activations are stored.
    pub number_format: NumberFormat,
    /// Order of the weights.
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
    /// Where the model comes from.
    pub provenance: Provenance,
}

/// Size of one layer and the scale of what it hands on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LayerShape {
    /// Inputs.
    pub input_count: u16,
    /// Outputs.
    pub output_count: u16,
    /// Integer formats, hidden layers: ELU (Q15.16) → stored activation,
    /// `round(elu · multiplier / 2^31 · 2^shift) + zero_point`.
    pub activation: ActivationScale,
}

/// See [`LayerShape::activation`]; all zeros where a layer has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActivationScale {
    /// Q0.31.
    pub multiplier: i32,
    /// Positive is to the left.
    pub shift: i8,
    /// Stored value of zero.
    pub zero_point: i16,
}

/// Sizes of the sampler's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SamplerShape {
    /// What a component is.
    pub kind: SamplerKind,
    /// Stored means: clips, or Gaussians.
    pub component_count: u32,
    /// Entries of all intervals together.
    pub member_count: u32,
    /// Length intervals of all actions together.
    pub interval_count: u16,
    /// `ClipCodes`: largest step towards a neighbour, Q0.16.
    pub step_max_q16: u32,
}

/// What makes a model reproducible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// SHA-256 of the training configuration.
    pub config_hash: [u8; 32],
    /// Seed of the training.
    pub seed: u64,
}

/// One group of channels, as stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Group<'a> {
    /// Unique name: a joint or a servo.
    pub name: &'a str,
    /// What the channels are.
    pub kind: GroupKind,
    /// Unit of every channel of the group.
    pub unit: Unit,
}

/// One joint of the skeleton, as stored; parents precede children.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    Components,
    /// i32: code units · 2^8 per 1 of a component. // (sequence code)
    ComponentSteps,
    /// u8, in units of the deviation steps; `DiagonalMixture` only. // (component, sequence code)
    Deviations,
    /// i32: code units · 2^8. `ClipCodes`: σ of the noise; `DiagonalMixture`: per 1 of a deviation. // (sequence code)
    DeviationSteps,
    /// Pairs of u16: component, cumulative weight (65,535 at an interval's last member). // (member, 2)
    Members,
    /// action u16, frames min u16, frames max u16, spread u16 (Q4.12: factor on the noise of `ClipCodes`),
    /// first member u32, members u32. // (interval)
    Intervals,
    /// i8 or binary16. // (out, in)
    Weights(usize),
    /// i32 in accumulator units, or f32; none for the time half. // (out)
    Bias(usize),
    /// i32, Q0.31; integer formats only. // (out)
    Multipliers(usize),
    /// i8, positive is to the left; integer formats only. // (out)
    Shifts(usize),
}

impl TensorKind {
    /// The part of the model that the tensor belongs to, for reports.
    pub const fn part(self) -> &'static str {
        match self {
            Self::Frequencies => "time embedding",
            Self::ActionCodes => "action codes",
            Self::Components | Self::ComponentSteps => "sampler means",
            Self::Deviations | Self::DeviationSteps => "sampler deviations",
            Self::Members | Self::Intervals => "sampler intervals",
            Self::Weights(_) => "weights",
            Self::Bias(_) => "biases",
            Self::Multipliers(_) | Self::Shifts(_) => "scales",
        }
    }
}

/// Bytes of one interval record.
pub(crate) const INTERVAL_BYTES: usize = 16;
/// Bytes of one member record.
pub(crate) const MEMBER_BYTES: usize = 4;
/// Index of the code half of layer 1 in [`Manifest::layers`].
pub const CODE_LAYER: usize = 0;
/// Index of the time half of layer 1 in [`Manifest::layers`].
pub const TIME_LAYER: usize = 1;

/// All tensors in file order with their lengths in bytes; 64 bits, so that no manifest can overflow them.
pub fn tensor_plan(manifest: &Manifest<'_>) -> impl Iterator<Item = (TensorKind, u64)> {
    let sampler = manifest.sampler;
    let code_count = u64::from(manifest.sequence_code_count);
    let component_numbers = u64::from(sampler.component_count) * code_count;
    let diagonal = u64::from(sampler.kind == SamplerKind::DiagonalMixture);
    let action_numbers = u64::from(manifest.action_count) * u64::from(manifest.action_code_count);
    let tables = [
        (TensorKind::Frequencies, 4 * u64::from(manifest.frequency_count)),
        (TensorKind::ActionCodes, 2 * action_numbers),
        (TensorKind::Components, component_numbers),
        (TensorKind::ComponentSteps, 4 * code_count),
        (TensorKind::Deviations, diagonal * component_numbers),
        (TensorKind::DeviationSteps, 4 * code_count),
        (TensorKind::Members, MEMBER_BYTES as u64 * u64::from(sampler.member_count)),
        (TensorKind::Intervals, INTERVAL_BYTES as u64 * u64::from(sampler.interval_count)),
    ];
    let format = manifest.number_format;
    let layers = manifest.layers.clone().into_iter().enumerate();
    tables
        .into_iter()
        .chain(layers.flat_map(move |(index, shape)| layer_plan(index, shape, format)))
}

fn layer_plan(index: usize, shape: LayerShape, format: NumberFormat) -> [(TensorKind, u64); 4] {
    let (rows, columns) = (u64::from(shape.output_count), u64::from(shape.input_count));
    let with_bias = u64::from(index != TIME_LAYER);
    let with_scales = u64::from(format != NumberFormat::F16);
    [
        (TensorKind::Weights(index), rows * columns * format.weight_bytes() as u64),
        (TensorKind::Bias(index), with_bias * 4 * rows),
        (TensorKind::Multipliers(index), with_scales * 4 * rows),
        (TensorKind::Shifts(index), with_scales * rows),
    ]
}
