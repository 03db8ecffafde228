//! A small model for the tests of this crate: two actions, four channels, weights from a generator.

use std::vec;
use std::vec::Vec;

use crate::blob::BlobParts;
use crate::manifest::*;
use crate::packing::ByteLayout;
use crate::pose_layout::{GroupKind, Unit};
use crate::random::Pcg32;

const SEQUENCE_CODE: usize = 3;
const ACTION_CODE: usize = 2;
const FREQUENCIES: usize = 4;
const COMPONENTS: usize = 5;

/// One of every kind of sampler.
pub const KINDS: [SamplerKind; 3] = [
    SamplerKind::ClipCodes,
    SamplerKind::DiagonalMixture,
    SamplerKind::NearestClips { clip_count: 2, row_bytes: 2 },
];

/// Bits of each number of a clip's code, for `NearestClips`.
const COLUMN_BITS: [u8; SEQUENCE_CODE] = [5, 0, 8];

/// (in, out) of code half, time half, hidden, output.
const SHAPES: [(u16, u16); 4] = [(5, 6), (8, 6), (6, 7), (7, 4)];

/// Bytes of the specimen, packed in tiles.
pub fn specimen(format: NumberFormat, kind: SamplerKind) -> Vec<u8> {
    specimen_packed(format, kind, Packing::Tiles)
}

/// The same weights in any packing.
pub fn specimen_packed(format: NumberFormat, kind: SamplerKind, packing: Packing) -> Vec<u8> {
    emit(&manifest(format, kind, packing), |_| None)
}

/// Rows of the specimen's code half with gates: of layer 1 and of two hidden layers' gates, each filled up to a
/// multiple of four.
pub const GATED_ROWS: u16 = 8 + 8 + 8;
/// The same with phases.
pub const TURNED_ROWS: u16 = GATED_ROWS + 4;

/// The specimen with another number of rows in its code half.
pub fn specimen_modulated(format: NumberFormat, rows: u16) -> Vec<u8> {
    let mut manifest = manifest(format, SamplerKind::ClipCodes, Packing::Tiles);
    manifest.layers[CODE_LAYER].output_count = rows;
    emit(&manifest, |_| None)
}

/// What no quantiser writes: phases, and a time table that does not know them.
pub fn specimen_with_table_and_phases(rows: &[Vec<i16>]) -> Vec<u8> {
    let mut manifest = manifest(NumberFormat::W8A16, SamplerKind::ClipCodes, Packing::Tiles);
    manifest.layers[CODE_LAYER].output_count = TURNED_ROWS;
    manifest.time_table_frames = rows.len() as u16;
    emit(&manifest, |_| None)
}

/// The specimen with a time table of `rows` · 2^`shift`, four numbers a block.
pub fn specimen_with_time_table(format: NumberFormat, rows: &[Vec<i16>], shift: u8) -> Vec<u8> {
    let mut manifest = manifest(format, SamplerKind::ClipCodes, Packing::Tiles);
    manifest.time_table_frames = rows.len() as u16;
    manifest.time_table_shift = shift;
    let bytes: Vec<u8> = rows.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    emit(&manifest, |kind| (kind == TensorKind::TimeTable).then(|| bytes.clone()))
}

fn emit(manifest: &Manifest<'_>, given: impl Fn(TensorKind) -> Option<Vec<u8>>) -> Vec<u8> {
    let mut random = Pcg32::new(42);
    let plan: Vec<_> = tensor_plan(manifest).collect();
    let make = |&(kind, length): &(TensorKind, u64)| {
        let bytes =
            given(kind).unwrap_or_else(|| tensor(kind, length as usize, manifest, &mut random));
        (kind, bytes)
    };
    let tensors: Vec<(TensorKind, Vec<u8>)> = plan.iter().map(make).collect();
    let tensors: Vec<(TensorKind, &[u8])> =
        tensors.iter().map(|(kind, bytes)| (*kind, bytes.as_slice())).collect();
    let groups = [
        Group { name: "root", kind: GroupKind::Translation, unit: Unit::Metre },
        Group { name: "jaw", kind: GroupKind::Scalar, unit: Unit::Degree },
    ];
    let joints = [
        Joint { name: "hip", parent: None, offset: [0.0; 3] },
        Joint { name: "head", parent: Some(0), offset: [0.0, 1.5, 0.0] },
    ];
    let actions = ["nod", "walk"];
    let parts = BlobParts {
        manifest,
        groups: &groups,
        actions: &actions,
        joints: &joints,
        tensors: &tensors,
    };
    let mut blob = vec![0xAA; 4096];
    let length = parts.emit(&mut blob).unwrap();
    blob.truncate(length);
    blob
}

fn manifest(format: NumberFormat, kind: SamplerKind, packing: Packing) -> Manifest<'static> {
    let bytes = format.activation_range().1 == 127;
    let activation = ActivationScale {
        power_step: if bytes { 13_000 } else { 30_000 },
        one: 16_500,
        one_shift: if bytes { 25 } else { 19 },
        zero_point: if bytes { -90 } else { 0 },
        fraction_bits: if bytes { 8 } else { 0 },
    };
    let layers = SHAPES.map(|(input_count, output_count)| LayerShape {
        input_count,
        output_count,
        weights: match format {
            NumberFormat::F16 => WeightFormat::Half,
            // One layer of the other kind, so that layers of both meet.
            NumberFormat::W4A8 if output_count != 7 => WeightFormat::I4,
            _ => WeightFormat::I8,
        },
        activation,
    });
    Manifest {
        name: "specimen",
        number_format: format,
        packing,
        rate_millihz: 50_000,
        group_count: 2,
        action_count: 2,
        joint_count: 2,
        sequence_code_count: SEQUENCE_CODE as u16,
        action_code_count: ACTION_CODE as u16,
        code_fraction_bits: 11,
        frequency_count: FREQUENCIES as u16,
        layers: layers.into_iter().collect(),
        sampler: SamplerShape {
            kind,
            component_count: COMPONENTS as u32,
            member_count: if is_nearest(kind) { 0 } else { 5 },
            interval_count: if is_nearest(kind) { 2 } else { 3 },
            step_max_q16: if kind == SamplerKind::DiagonalMixture { 0 } else { 13_107 },
        },
        time_table_frames: 0,
        time_table_shift: 0,
        provenance: Provenance { config_hash: [7; 32], seed: 9 },
    }
}

fn is_nearest(kind: SamplerKind) -> bool {
    matches!(kind, SamplerKind::NearestClips { .. })
}

fn tensor(kind: TensorKind, length: usize, manifest: &Manifest<'_>, random: &mut Pcg32) -> Vec<u8> {
    let format = manifest.number_format;
    let noise = |random: &mut Pcg32| (random.next_u32() >> 24) as u8;
    match kind {
        _ if length == 0 => Vec::new(),
        TensorKind::Frequencies => [1u32 << 27, 1 << 25, 1 << 23, 1 << 20]
            .iter()
            .flat_map(|step| step.to_le_bytes())
            .collect(),
        TensorKind::ComponentSteps => {
            [5000i32; SEQUENCE_CODE].iter().flat_map(|x| x.to_le_bytes()).collect()
        }
        TensorKind::DeviationSteps => {
            [30_000i32; SEQUENCE_CODE].iter().flat_map(|x| x.to_le_bytes()).collect()
        }
        TensorKind::Members => {
            let members: [[u16; 2]; 5] =
                [[0, 30_000], [1, 65_535], [2, 65_535], [3, 40_000], [4, 65_535]];
            members.iter().flatten().flat_map(|x| x.to_le_bytes()).collect()
        }
        TensorKind::Columns => {
            let least = (-300i16).to_le_bytes();
            COLUMN_BITS.iter().flat_map(|&bits| [least[0], least[1], bits, 0]).collect()
        }
        TensorKind::Lengths => {
            [10u16, 20, 30, 40, 50].iter().flat_map(|length| length.to_le_bytes()).collect()
        }
        TensorKind::Intervals if is_nearest(manifest.sampler.kind) => {
            [interval(0, 10..=30, 0, 3), interval(1, 40..=50, 3, 2)].concat()
        }
        TensorKind::Intervals => {
            [interval(0, 10..=19, 0, 2), interval(0, 20..=30, 2, 1), interval(1, 40..=50, 3, 2)]
                .concat()
        }
        TensorKind::Weights(_) if format == NumberFormat::F16 => (0..length / 2)
            .flat_map(|_| (0x3000 | (random.next_u32() as u16 & 0x83FF)).to_le_bytes())
            .collect(),
        TensorKind::Weights(index) if manifest.layers[index].weights == WeightFormat::I8 => {
            let shape = manifest.layers[index];
            let count = usize::from(shape.input_count) * usize::from(shape.output_count);
            let weights: Vec<i8> =
                (0..count).map(|_| (noise(random).cast_signed()).max(-127)).collect();
            let mut packed = vec![0; length];
            let narrow = index != CODE_LAYER && format != NumberFormat::W8A16;
            ByteLayout::new(manifest.packing, narrow).pack(&shape, &weights, &mut packed);
            packed
        }
        TensorKind::GroupScales(_) => (0..length / 2)
            .flat_map(|_| (0x4000 | (random.next_u32() as u16 & 0x3FFF)).to_le_bytes())
            .collect(),
        TensorKind::Bias(_) if format == NumberFormat::F16 => {
            (0..length / 4).flat_map(|_| (f32::from(noise(random)) / 256.0).to_le_bytes()).collect()
        }
        TensorKind::Bias(_) => {
            (0..length / 4).flat_map(|_| (random.next_u32() as i32 >> 14).to_le_bytes()).collect()
        }
        TensorKind::Scales(index) => {
            // The last layer's channels are Q15.16, everything else is accumulators or activations.
            let right = if index + 1 == SHAPES.len() { 32 } else { 38 };
            (0..length / 4).flat_map(|_| ((0x5000_0000u32 & !63) | right).to_le_bytes()).collect()
        }
        _ => (0..length).map(|_| noise(random)).collect(),
    }
}

fn interval(
    action: u16,
    frames: core::ops::RangeInclusive<u16>,
    first: u32,
    count: u32,
) -> Vec<u8> {
    let halves = [action, *frames.start(), *frames.end(), 4096].map(u16::to_le_bytes).concat();
    [halves, [first, count].map(u32::to_le_bytes).concat()].concat()
}

// Miri is shut off from files.
#[cfg(all(test, not(miri)))]
mod tests {
    use std::path::Path;
    use std::string::String;
    use std::{env, format, fs};

    use super::*;

    fn seeds() -> Vec<(String, Vec<u8>)> {
        let (clips, mixture) = (SamplerKind::ClipCodes, SamplerKind::DiagonalMixture);
        let mut seeds = Vec::new();
        for format in NumberFormat::ALL {
            let name = format.name();
            seeds.push((format!("{name}-clips"), specimen(format, clips)));
            seeds.push((format!("{name}-mixture"), specimen(format, mixture)));
            seeds.push((format!("{name}-nearest"), specimen(format, KINDS[2])));
        }
        for format in [NumberFormat::W8A16, NumberFormat::W8A8, NumberFormat::W4A8] {
            let name = format.name();
            seeds.push((format!("{name}-gates"), specimen_modulated(format, TURNED_ROWS)));
            let rows = [vec![1; 8], vec![-1; 8], vec![i16::MAX; 8]];
            seeds.push((format!("{name}-rows"), specimen_packed(format, clips, Packing::Rows)));
            seeds.push((format!("{name}-table"), specimen_with_time_table(format, &rows, 3)));
        }
        seeds
    }

    /// Fuzzing starts from specimens; after a change of the format, `UPDATE_GOLDEN=1 cargo test -p karakuri` writes
    /// them anew.
    #[test]
    fn seeds_of_the_fuzzers_are_the_specimens() {
        for (name, blob) in seeds() {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
            let path = folder.join(format!("{name}.kara"));
            if env::var_os("UPDATE_GOLDEN").is_some() {
                fs::write(&path, &blob).unwrap();
            }
            let remedy = "run UPDATE_GOLDEN=1 cargo test -p karakuri";
            assert!(fs::read(&path).unwrap() == blob, "{}: {remedy}", path.display());
        }
    }
}
