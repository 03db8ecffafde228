//! Station 6d: layers as they go into the blob.

use karakuri::manifest::{ActivationScale, LayerShape, TensorKind, WeightFormat};

use crate::float_model::DenseLayer;

/// Shapes and tensors of all layers.
#[derive(Default)]
pub struct StoredLayers {
    /// // (layer)
    pub shapes: Vec<LayerShape>,
    /// Little-endian, packed.
    pub tensors: Vec<(TensorKind, Vec<u8>)>,
    /// Largest share of 2^31 that any accumulator can reach; integer formats. // (layer)
    pub accumulator_use: Vec<f64>,
}

/// Shape of a layer in the manifest.
pub fn shape_of(
    layer: &DenseLayer,
    weights: WeightFormat,
    activation: ActivationScale,
) -> LayerShape {
    LayerShape {
        input_count: layer.input_count as u16,
        output_count: layer.output_count as u16,
        weights,
        activation,
    }
}
