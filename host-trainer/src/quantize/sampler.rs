//! Station 6c: codes and mixtures → the sampler's tables in the blob.
//!
//! In:  the code tables of a checkpoint, and the mixtures fitted to them (for `ClipCodes` their intervals alone).
//! Out: little-endian tensors, one byte a number for what grows with the clips.
//!
//! Source: shared/data/README.md, last table: clip codes with one shared σ and up to 20 % towards a neighbour scored
//! better than full covariances of 14 times the size.

use karakuri::manifest::{SamplerKind, SamplerShape, TensorKind};

use crate::float_model::CodeTable;
use crate::mixture::Factor;
use crate::mixture::set::{IntervalMixture, MixtureSet};

/// Largest step towards a neighbour, as a share of the way.
const STEP_MAX: f64 = 0.2;

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

/// Builds the tables of a sampler of `kind`.
pub fn quantize_sampler(
    kind: SamplerKind,
    sequence_codes: &CodeTable,
    mixtures: &MixtureSet,
    code_fraction_bits: u8,
) -> QuantizedSampler {
    let code_unit = 2f64.powi(-i32::from(code_fraction_bits));
    match kind {
        SamplerKind::ClipCodes => clip_codes(sequence_codes, mixtures, code_unit),
        SamplerKind::DiagonalMixture => diagonal_mixture(mixtures, code_unit),
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

fn clip_codes(codes: &CodeTable, mixtures: &MixtureSet, code_unit: f64) -> QuantizedSampler {
    let dimensions = codes.dimension_count;
    let rows: Vec<Vec<f64>> = codes
        .mean
        .chunks_exact(dimensions)
        .map(|row| row.iter().map(|&x| f64::from(x)).collect())
        .collect();
    let variances: Vec<Vec<f64>> = codes
        .log_variance
        .chunks_exact(dimensions)
        .map(|row| row.iter().map(|&x| f64::from(x).exp()).collect())
        .collect();
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
