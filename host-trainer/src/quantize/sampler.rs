//! Station 6c: codes and mixtures → the sampler's tables in the blob.
//!
//! In:  the code tables of a checkpoint, and the mixtures fitted to them (for `ClipCodes` their intervals alone, for
//!      `NearestClips` nothing).
//! Out: little-endian tensors, at most one byte a number for what grows with the clips.
//!
//! Why here: `sampler` measures; this writes what won, and two others, as core reads them.

use karakuri::manifest::{SamplerKind, SamplerShape, TensorKind};

use crate::dataset::DatasetDescription;
use crate::float_model::CodeTable;
use crate::mixture::Factor;
use crate::mixture::set::{IntervalMixture, MixtureSet};
use crate::sampler::SamplerChoice;
use crate::sampler::column::{Column, fit_columns};
use crate::sampler::interval_clips::STEP_MAX;
use crate::sampler::nearest_clips::{ActionClips, ClipOptions, quiet, shared_deviations};

/// Unit of the intervals' spread: 1 is 4096.
const SPREAD_ONE: f64 = 4096.0;

/// Tables of one sampler.
pub struct QuantizedSampler {
    /// For the manifest.
    pub shape: SamplerShape,
    /// For the blob.
    pub tensors: Vec<(TensorKind, Vec<u8>)>,
}

/// Fraction bits at which every code that will be drawn fits 16 bits: mean ± 5 σ of every row of both tables.
pub fn code_fraction_bits(tables: [&CodeTable; 2]) -> u8 {
    let reach = |table: &CodeTable| {
        let rows = table.mean.iter().zip(&table.log_variance);
        rows.map(|(mean, log_variance)| mean.abs() + 5.0 * (0.5 * log_variance).exp())
            .fold(0.0, f32::max)
    };
    let largest = f64::from(reach(tables[0]).max(reach(tables[1]))).max(1.0);
    (0..=14).rev().find(|&bits| largest * f64::from(1 << bits) < 32_767.0).unwrap_or(0)
}

/// Builds the tables of a sampler.
pub fn quantize_sampler(
    choice: SamplerChoice,
    sequence_codes: &CodeTable,
    dataset: &DatasetDescription,
    mixtures: &MixtureSet,
    code_fraction_bits: u8,
) -> QuantizedSampler {
    let code_unit = 2f64.powi(-i32::from(code_fraction_bits));
    match choice {
        SamplerChoice::NearestClips(options) => {
            nearest_clips(sequence_codes, dataset, options, code_unit)
        }
        SamplerChoice::ClipCodes => clip_codes(sequence_codes, mixtures, code_unit),
        SamplerChoice::DiagonalMixture => diagonal_mixture(mixtures, code_unit),
    }
}

/// A table whose columns have a step each.
struct ByteTable {
    bytes: Vec<u8>,
    /// Real value of 1. // (dimension)
    steps: Vec<f64>,
}

/// Stores rows at one byte a number: −127..=127 for signed tables, 0..=255 otherwise.
fn byte_table(rows: &[Vec<f64>], full_scale: f64) -> ByteTable {
    let dimensions = rows.first().map_or(0, Vec::len);
    let largest = |column: usize| rows.iter().map(|row| row[column].abs()).fold(0.0, f64::max);
    let steps: Vec<f64> =
        (0..dimensions).map(|column| largest(column).max(1e-6) / full_scale).collect();
    let store = |(value, step): (&f64, &f64)| (value / step).round() as i32 as u8;
    let bytes = rows.iter().flat_map(|row| row.iter().zip(&steps).map(store)).collect();
    ByteTable { bytes, steps }
}

/// Steps in code units · 2^8.
fn step_bytes(steps: &[f64], code_unit: f64) -> Vec<u8> {
    steps
        .iter()
        .flat_map(|step| ((step / code_unit * 256.0).round() as i32).to_le_bytes())
        .collect()
}

fn nearest_clips(
    codes: &CodeTable,
    dataset: &DatasetDescription,
    options: ClipOptions,
    code_unit: f64,
) -> QuantizedSampler {
    let rows = rows_of(&codes.mean, codes.dimension_count, f64::from);
    let learned = shared_deviations(codes);
    let (columns, errors): (Vec<Column>, Vec<f64>) =
        fit_columns(&rows, &learned, options.bits_mean).into_iter().unzip();
    let deviations: Vec<f64> =
        quiet(&learned, &errors).iter().map(|deviation| options.noise * deviation).collect();
    let bits: usize = columns.iter().map(|column| usize::from(column.bits)).sum();
    let actions = ActionClips::of_dataset(dataset);
    let (mut components, mut lengths, mut intervals) = (Vec::new(), Vec::new(), Vec::new());
    for action in &actions {
        let first = lengths.len() / 2;
        for (&clip, &length) in action.clips.iter().zip(&action.lengths) {
            components.extend(packed_row(&rows[clip], &columns));
            lengths.extend((length as u16).to_le_bytes());
        }
        let ends = [action.lengths[0], action.lengths[action.lengths.len() - 1]];
        push_u16s(&mut intervals, [action.action, ends[0]]);
        push_u16s(&mut intervals, [ends[1], SPREAD_ONE as usize]);
        intervals.extend((first as u32).to_le_bytes());
        intervals.extend((action.clips.len() as u32).to_le_bytes());
    }
    let shape = SamplerShape {
        kind: SamplerKind::NearestClips {
            clip_count: options.clip_count.clamp(1, usize::from(u16::MAX)) as u16,
            row_bytes: bits.div_ceil(8) as u16,
        },
        component_count: rows.len() as u32,
        member_count: 0,
        interval_count: actions.len() as u16,
        step_max_q16: (options.step_max.clamp(0.0, 1.0) * 65_536.0) as u32,
    };
    let steps: Vec<f64> = columns.iter().map(|column| column.step).collect();
    let tensors = vec![
        (TensorKind::Components, components),
        (TensorKind::ComponentSteps, step_bytes(&steps, code_unit)),
        (TensorKind::Columns, column_bytes(&columns, code_unit)),
        (TensorKind::DeviationSteps, step_bytes(&deviations, code_unit)),
        (TensorKind::Lengths, lengths),
        (TensorKind::Intervals, intervals),
    ];
    QuantizedSampler { shape, tensors }
}

/// The numbers of a row one after another, the lowest bits first, filled up to a whole byte.
fn packed_row(row: &[f64], columns: &[Column]) -> Vec<u8> {
    let bits: usize = columns.iter().map(|column| usize::from(column.bits)).sum();
    // A number may reach into the next byte, also one of no bits behind the last full one.
    let mut bytes = vec![0; bits / 8 + 2];
    let mut place = 0;
    for (value, column) in row.iter().zip(columns) {
        let [low, high] = (u16::from(column.encode(*value)) << (place % 8)).to_le_bytes();
        bytes[place / 8] |= low;
        bytes[place / 8 + 1] |= high;
        place += usize::from(column.bits);
    }
    bytes.truncate(bits.div_ceil(8));
    bytes
}

fn column_bytes(columns: &[Column], code_unit: f64) -> Vec<u8> {
    let record = |column: &Column| {
        let [low, high] = ((column.least / code_unit).round() as i16).to_le_bytes();
        [low, high, column.bits, 0]
    };
    columns.iter().flat_map(record).collect()
}

fn rows_of(values: &[f32], dimensions: usize, of: impl Fn(f32) -> f64) -> Vec<Vec<f64>> {
    values.chunks_exact(dimensions).map(|row| row.iter().map(|&x| of(x)).collect()).collect()
}

fn clip_codes(codes: &CodeTable, mixtures: &MixtureSet, code_unit: f64) -> QuantizedSampler {
    let dimensions = codes.dimension_count;
    let rows = rows_of(&codes.mean, dimensions, f64::from);
    let variances = rows_of(&codes.log_variance, dimensions, |x| f64::from(x).exp());
    let all: Vec<usize> = (0..rows.len()).collect();
    let shared: Vec<f64> =
        mean_variance(&variances, &all).iter().map(|variance| variance.sqrt()).collect();
    let table = byte_table(&rows, 127.0);
    let (mut members, mut intervals) = (Vec::new(), Vec::new());
    for interval in &mixtures.intervals {
        let spread = spread(&mean_variance(&variances, &interval.clips), &shared);
        let first = members.len() / 4;
        for (position, &clip) in interval.clips.iter().enumerate() {
            let weight = (position + 1) * usize::from(u16::MAX) / interval.clips.len();
            push_u16s(&mut members, [clip, weight]);
        }
        push_interval(&mut intervals, interval, spread, first, interval.clips.len());
    }
    let shape = SamplerShape {
        kind: SamplerKind::ClipCodes,
        component_count: rows.len() as u32,
        member_count: (members.len() / 4) as u32,
        interval_count: mixtures.intervals.len() as u16,
        step_max_q16: (STEP_MAX * 65_536.0) as u32,
    };
    let tensors = vec![
        (TensorKind::Components, table.bytes),
        (TensorKind::ComponentSteps, step_bytes(&table.steps, code_unit)),
        (TensorKind::DeviationSteps, step_bytes(&shared, code_unit)),
        (TensorKind::Members, members),
        (TensorKind::Intervals, intervals),
    ];
    QuantizedSampler { shape, tensors }
}

fn diagonal_mixture(mixtures: &MixtureSet, code_unit: f64) -> QuantizedSampler {
    let components = || mixtures.intervals.iter().flat_map(|interval| &interval.mixture.components);
    let means: Vec<Vec<f64>> = components().map(|component| component.mean.clone()).collect();
    let deviations: Vec<Vec<f64>> =
        components().map(|component| component.factor.deviations()).collect();
    let (mean_table, deviation_table) = (byte_table(&means, 127.0), byte_table(&deviations, 255.0));
    let (mut members, mut intervals) = (Vec::new(), Vec::new());
    for interval in &mixtures.intervals {
        let first = members.len() / 4;
        let mut cumulative = 0.0;
        for (position, component) in interval.mixture.components.iter().enumerate() {
            cumulative += component.weight;
            let weight = (cumulative * f64::from(u16::MAX)).round().min(f64::from(u16::MAX));
            push_u16s(&mut members, [first + position, weight as usize]);
        }
        push_interval(&mut intervals, interval, 1.0, first, interval.mixture.components.len());
    }
    let shape = SamplerShape {
        kind: SamplerKind::DiagonalMixture,
        component_count: means.len() as u32,
        member_count: (members.len() / 4) as u32,
        interval_count: mixtures.intervals.len() as u16,
        step_max_q16: 0,
    };
    let tensors = vec![
        (TensorKind::Components, mean_table.bytes),
        (TensorKind::ComponentSteps, step_bytes(&mean_table.steps, code_unit)),
        (TensorKind::Deviations, deviation_table.bytes),
        (TensorKind::DeviationSteps, step_bytes(&deviation_table.steps, code_unit)),
        (TensorKind::Members, members),
        (TensorKind::Intervals, intervals),
    ];
    QuantizedSampler { shape, tensors }
}

impl Factor {
    /// Standard deviations along the axes; what a diagonal sampler keeps of a full covariance.
    fn deviations(&self) -> Vec<f64> {
        match self {
            Self::Diagonal(deviations) => deviations.clone(),
            Self::Full(lower) => {
                let mut rest = lower.as_slice();
                let mut deviations = Vec::new();
                while !rest.is_empty() {
                    let (row, after) = rest.split_at(deviations.len() + 1);
                    deviations.push(row.iter().map(|x| x * x).sum::<f64>().sqrt());
                    rest = after;
                }
                deviations
            }
        }
    }
}

fn mean_variance(variances: &[Vec<f64>], rows: &[usize]) -> Vec<f64> {
    let dimensions = variances.first().map_or(0, Vec::len);
    let mean = |column: usize| {
        rows.iter().map(|&row| variances[row][column]).sum::<f64>() / rows.len() as f64
    };
    (0..dimensions).map(mean).collect()
}

/// How much wider than the shared noise an interval's clips are, root mean square over the dimensions.
fn spread(variances: &[f64], shared: &[f64]) -> f64 {
    let ratios =
        variances.iter().zip(shared).map(|(variance, sigma)| variance / (sigma * sigma).max(1e-12));
    (ratios.sum::<f64>() / shared.len().max(1) as f64).sqrt()
}

fn push_u16s(bytes: &mut Vec<u8>, values: [usize; 2]) {
    bytes.extend(values.iter().flat_map(|&value| (value as u16).to_le_bytes()));
}

fn push_interval(
    bytes: &mut Vec<u8>,
    interval: &IntervalMixture,
    spread: f64,
    member_first: usize,
    member_count: usize,
) {
    let spread = (spread * SPREAD_ONE).round().clamp(0.0, 65_535.0) as usize;
    push_u16s(bytes, [interval.action, interval.frames_min]);
    push_u16s(bytes, [interval.frames_max, spread]);
    bytes.extend((member_first as u32).to_le_bytes());
    bytes.extend((member_count as u32).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_packed_from_the_lowest_bit() {
        let column = |bits| Column { least: 0.0, step: 1.0, bits };
        let columns = [column(3), column(0), column(8), column(6)];
        // 5 = 101, 200 = 11001000, 33 = 100001; read from the right.
        let packed = packed_row(&[5.0, 9.0, 200.0, 33.0], &columns);
        assert_eq!(packed, [0b0100_0101, 0b0000_1110, 0b1]);
    }

    #[test]
    fn numbers_of_no_bits_behind_a_full_byte_take_no_room() {
        let column = |bits| Column { least: 0.0, step: 1.0, bits };
        assert_eq!(packed_row(&[7.0, 7.0], &[column(0), column(0)]), [0u8; 0]);
        assert_eq!(packed_row(&[200.0, 7.0], &[column(8), column(0)]), [200]);
    }
}
