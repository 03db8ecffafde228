//! Station 6d: layers in binary16.

use half::f16;
use karakuri::manifest::{ActivationScale, TIME_LAYER, TensorKind, WeightFormat};

use crate::error::{Error, Result};
use crate::float_model::DenseLayer;
use crate::quantize::stored::{StoredLayers, shape_of};

/// Packs every layer: blocks of four rows, a column's four weights together.
///
/// # Errors
/// A weight beyond the range of binary16.
pub fn half_layers(layers: &[DenseLayer]) -> Result<StoredLayers> {
    let mut stored = StoredLayers::default();
    for (index, layer) in layers.iter().enumerate() {
        refuse_infinite(index, layer)?;
        let rows: Vec<&[f32]> = layer.weights.chunks_exact(layer.input_count).collect();
        let weight = |row: usize, column: usize| rows.get(row).map_or(0.0, |row| row[column]);
        let mut weights = Vec::new();
        for block in (0..rows.len()).step_by(4) {
            for column in 0..layer.input_count {
                let four = (block..block + 4).map(|row| f16::from_f32(weight(row, column)));
                weights.extend(four.flat_map(f16::to_le_bytes));
            }
        }
        stored.tensors.push((TensorKind::Weights(index), weights));
        if index != TIME_LAYER {
            let filling = rows.len().next_multiple_of(4) - rows.len();
            let bias = layer.bias.iter().copied().chain(std::iter::repeat_n(0.0, filling));
            let bias = bias.flat_map(f32::to_le_bytes).collect();
            stored.tensors.push((TensorKind::Bias(index), bias));
        }
        stored.shapes.push(shape_of(layer, WeightFormat::Half, ActivationScale::NONE));
    }
    Ok(stored)
}

fn refuse_infinite(index: usize, layer: &DenseLayer) -> Result<()> {
    match layer.weights.iter().find(|&&weight| !f16::from_f32(weight).is_finite()) {
        None => Ok(()),
        Some(weight) => Err(Error::bad_input(
            "checkpoint",
            format!("weight of layer {index}"),
            weight,
            "a magnitude of at most 65504, the largest of binary16",
            "quantise to w8a16, or lower the learning rate and train again",
        )),
    }
}
