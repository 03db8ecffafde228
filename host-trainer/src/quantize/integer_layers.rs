//! Station 6d: layers in integers, each with i8 or 4-bit weights.
//!
//! In:  float layers as the device has them, and the scales of their inputs.
//! Out: packed tensors; every row carries its certificate.

use karakuri::Requantizer;
use karakuri::manifest::{
    ActivationScale, CODE_LAYER, GATE_MAX, NumberFormat, Packing, TIME_LAYER, TensorKind,
    WeightFormat,
};
use karakuri::packing::ByteLayout;

use crate::error::{Error, Result};
use crate::float_model::DenseLayer;
use crate::quantize::layer::{InputScale, quantize_layer};
use crate::quantize::nibble::{pack_nibbles, quantize_nibble_row};
use crate::quantize::scale::{elu_scale, requantizer_of};
use crate::quantize::stored::{StoredLayers, shape_of};

/// What the integer layers are made of.
#[derive(Clone, Copy)]
pub struct IntegerInput<'a> {
    /// Code half, time half, the others.
    pub layers: &'a [DenseLayer],
    /// How the inputs of every layer after the time half are stored.
    pub hidden: &'a [InputScale],
    /// Means of these inputs, to correct biases for the rounding of weights; empty: no correction. // (layer)(input)
    pub means: &'a [Vec<f32>],
    /// `F16` has no integer layers.
    pub format: NumberFormat,
    /// Order of 8-bit weights.
    pub packing: Packing,
    /// // (layer)
    pub weights: &'a [WeightFormat],
    /// Of the codes.
    pub code_fraction_bits: u8,
}

/// One layer's rows, packed, with filled rows.
struct StoredRows {
    weights: Vec<u8>,
    group_scales: Vec<u8>,
    bias: Vec<i32>,
    /// Real value of an accumulator's 1. // (out)
    accumulator_scales: Vec<f64>,
    accumulator_use: f64,
}

/// Quantises and packs every layer.
///
/// # Errors
/// A layer whose weights are so large that its accumulators are coarser than its stored activations.
pub fn integer_layers(input: IntegerInput<'_>) -> Result<StoredLayers> {
    let inputs = input_scales(input);
    let rows: Vec<StoredRows> =
        (0..input.layers.len()).map(|index| store_rows(input, index, inputs[index])).collect();
    let mut stored = StoredLayers::default();
    for (index, layer) in input.layers.iter().enumerate() {
        let scales = &rows[index].accumulator_scales;
        let is_last = index + 1 == input.layers.len();
        let mut activation = ActivationScale::NONE;
        let factors: Vec<f64> = if index == CODE_LAYER {
            code_factors(scales, &rows[TIME_LAYER].accumulator_scales)
        } else if is_last {
            scales.iter().map(|scale| scale * 65_536.0).collect()
        } else {
            let next = &inputs[index + 1];
            let scales: Vec<f64> = scales.iter().map(|scale| scale * gate_max(input)).collect();
            let bits = fraction_bits(index, &scales, next, input.format)?;
            activation = elu_scale(next, bits);
            scales.iter().map(|scale| scale / next.scale * f64::from(1u32 << bits)).collect()
        };
        stored.shapes.push(shape_of(layer, input.weights[index], activation));
        stored.tensors.extend(layer_tensors(index, &rows[index], &factors));
        stored.accumulator_use.push(rows[index].accumulator_use);
    }
    Ok(stored)
}

/// Rows of layer 1 become accumulators of its time half, gates and phases numbers in Q16.
fn code_factors(scales: &[f64], time_half: &[f64]) -> Vec<f64> {
    let starts = scales.iter().zip(time_half).map(|(scale, time)| scale / time);
    let first = time_half.len().next_multiple_of(4).min(scales.len());
    let filling = (time_half.len()..first).map(|_| 0.0);
    starts.chain(filling).chain(scales[first..].iter().map(|scale| scale * 65_536.0)).collect()
}

/// The largest factor that a motion can put on the scale of a hidden row.
fn gate_max(input: IntegerInput<'_>) -> f64 {
    let [code_half, time_half] = [CODE_LAYER, TIME_LAYER].map(|index| &input.layers[index]);
    let has_gates = code_half.output_count != time_half.output_count;
    if has_gates { f64::from(GATE_MAX) } else { 1.0 }
}

/// How the inputs of every layer are stored.
pub fn input_scales(input: IntegerInput<'_>) -> Vec<InputScale> {
    let unit = 2f64.powi(-i32::from(input.code_fraction_bits));
    // 4-bit weights take a code in two bytes; the lower one adds at most 1/256 to what the upper one can cause.
    let code = match input.weights[CODE_LAYER] {
        WeightFormat::I4 => InputScale { scale: 256.0 * unit, zero_point: 0, magnitude_max: 130 },
        _ => InputScale { scale: unit, zero_point: 0, magnitude_max: 1 << 15 },
    };
    let one = i64::from(input.format.sinusoid_one());
    let time = InputScale { scale: 1.0 / one as f64, zero_point: 0, magnitude_max: one };
    [code, time].into_iter().chain(input.hidden.iter().copied()).collect()
}

/// Accumulators per product of an i8 weight and an input: 256 where the kernel multiplies two weights at once.
pub fn product_unit(index: usize, format: NumberFormat) -> i64 {
    if activations_are_bytes(index, format) { 256 } else { 1 }
}

/// Codes have 16 bits in every format.
fn activations_are_bytes(index: usize, format: NumberFormat) -> bool {
    index != CODE_LAYER && format.activation_range().1 == 127
}

/// Fraction bits of pre-activations: as many as the narrow requantizer can serve; 16-bit activations need none.
fn fraction_bits(
    index: usize,
    accumulator_scales: &[f64],
    next: &InputScale,
    format: NumberFormat,
) -> Result<u8> {
    let wanted = if format.activation_range().1 == 127 { 8 } else { 0 };
    let coarsest = accumulator_scales.iter().copied().fold(0.0, f64::max) / next.scale;
    // The narrow requantizer's factors are below 1/4.
    let fits = |bits: &u8| coarsest * f64::from(1u32 << bits) < 0.249;
    (0..=wanted).rev().find(fits).ok_or_else(|| {
        Error::bad_input(
            "checkpoint",
            format!("weights of layer {index}"),
            format!("an accumulator step of {coarsest:.2} activation steps"),
            "less than 1/4",
            "quantise to w8a16, or train with smaller weights",
        )
    })
}

fn store_rows(input: IntegerInput<'_>, index: usize, scale: InputScale) -> StoredRows {
    let layer = &input.layers[index];
    let means = match index {
        CODE_LAYER | TIME_LAYER => &[][..],
        _ => input.means[index - TIME_LAYER - 1].as_slice(),
    };
    if input.weights[index] == WeightFormat::I4 {
        return store_nibble_rows(layer, scale, means);
    }
    let bytes = activations_are_bytes(index, input.format);
    let quantized = quantize_layer(layer, scale, means, product_unit(index, input.format));
    let shape = shape_of(layer, WeightFormat::I8, ActivationScale::NONE);
    let mut weights = vec![0; shape.rows_filled() / 4 * shape.block_bytes()];
    ByteLayout::new(input.packing, bytes).pack(&shape, &quantized.weights, &mut weights);
    StoredRows {
        weights,
        group_scales: Vec::new(),
        bias: quantized.bias,
        accumulator_scales: quantized.accumulator_scales,
        accumulator_use: quantized.accumulator_use.into_iter().fold(0.0, f64::max),
    }
}

fn store_nibble_rows(layer: &DenseLayer, scale: InputScale, means: &[f32]) -> StoredRows {
    let float_rows = layer.weights.chunks_exact(layer.input_count).zip(&layer.bias);
    let rows: Vec<_> = float_rows
        .map(|(weights, &bias)| quantize_nibble_row(weights, f64::from(bias), scale, means))
        .collect();
    let packed = pack_nibbles(&rows);
    let largest = rows.iter().map(|row| row.accumulator_max).max().unwrap_or(0);
    StoredRows {
        weights: packed.words,
        group_scales: packed.group_scales,
        bias: rows.iter().map(|row| row.bias).collect(),
        accumulator_scales: rows.iter().map(|row| row.scale * scale.scale).collect(),
        accumulator_use: largest as f64 / 2f64.powi(31),
    }
}

fn layer_tensors(
    index: usize,
    rows: &StoredRows,
    factors: &[f64],
) -> impl Iterator<Item = (TensorKind, Vec<u8>)> {
    let filling = rows.bias.len().next_multiple_of(4) - rows.bias.len();
    let words = factors.iter().map(|&factor| requantizer_of(factor));
    let words = words.chain(std::iter::repeat_n(Requantizer::TINY, filling));
    let scales = words.flat_map(|word| word.to_bits().to_le_bytes()).collect();
    let biases = rows.bias.iter().copied().chain(std::iter::repeat_n(0, filling));
    let bias =
        if index == TIME_LAYER { Vec::new() } else { biases.flat_map(i32::to_le_bytes).collect() };
    let tensors = [
        (TensorKind::Weights(index), rows.weights.clone()),
        (TensorKind::GroupScales(index), rows.group_scales.clone()),
        (TensorKind::Bias(index), bias),
        (TensorKind::Scales(index), scales),
    ];
    tensors.into_iter().filter(|(_, bytes)| !bytes.is_empty())
}
