//! Station 6b: one float layer → integer rows whose accumulators provably cannot overflow.
//!
//! real output = row scale · input scale · (Σ w·q + bias), with w the stored weight, q the stored input, and the
//! input's zero point folded into the bias.
//!
//! Source: Jacob et al., CVPR 2018, for scales and zero points; Nagel et al., ICCV 2019, section 4.2, for the bias
//! correction (here from calibrated means).

use crate::float_model::DenseLayer;
use crate::quantize::calibrate::Observed;

/// How a layer's stored inputs map to real values: `real = scale · (stored − zero_point)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputScale {
    /// Real value of 1.
    pub scale: f64,
    /// Stored value of zero.
    pub zero_point: i16,
    /// Largest magnitude of a stored input.
    pub magnitude_max: i64,
}

/// Integer rows of one layer; see `karakuri::manifest::TensorKind` for the formats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IntegerLayer {
    /// // (out, in)
    pub weights: Vec<i8>,
    /// Accumulator units. // (out)
    pub bias: Vec<i32>,
    /// Real value of an accumulator's 1. // (out)
    pub accumulator_scales: Vec<f64>,
    /// Largest accumulator that any input can cause, as a share of 2^31; the certificate. // (out)
    pub accumulator_use: Vec<f64>,
}

/// Quantises every row; `input_mean` (may be empty) corrects the bias for the rounding of the weights, and a product of
/// a weight and an input counts `product_unit` accumulators (256 where the kernel adds products so).
pub fn quantize_layer(
    layer: &DenseLayer,
    input: InputScale,
    input_mean: &[f32],
    product_unit: i64,
) -> IntegerLayer {
    let mut result = IntegerLayer::default();
    for (weights, &bias) in layer.weights.chunks_exact(layer.input_count).zip(&layer.bias) {
        let row = FloatRow { weights, bias: f64::from(bias), input, input_mean, product_unit };
        let row = row.quantize();
        result.weights.extend(row.weights);
        result.bias.push(row.bias);
        result.accumulator_scales.push(row.scale * input.scale / product_unit as f64);
        result.accumulator_use.push(row.accumulator_max as f64 / 2f64.powi(31));
    }
    result
}

struct Row {
    weights: Vec<i8>,
    bias: i32,
    scale: f64,
    accumulator_max: i64,
}

struct FloatRow<'a> {
    weights: &'a [f32],
    bias: f64,
    input: InputScale,
    input_mean: &'a [f32],
    product_unit: i64,
}

impl FloatRow<'_> {
    /// At the finest scale at which the certificate Σ|w|·max|q|·unit + |bias| < 2^31 holds.
    fn quantize(&self) -> Row {
        let magnitudes = self.weights.iter().map(|&weight| f64::from(weight).abs());
        let largest = magnitudes.fold(0.0, f64::max);
        // An all-zero row still needs a scale at which its bias fits.
        let mut scale = (largest / 127.0)
            .max(self.bias.abs() * self.product_unit as f64 / (self.input.scale * 2f64.powi(30)))
            .max(f64::MIN_POSITIVE * 1e20);
        loop {
            if let Some(row) = self.quantize_at(scale) {
                return row;
            }
            scale *= 1.02;
        }
    }

    fn quantize_at(&self, scale: f64) -> Option<Row> {
        let round = |&weight: &f32| (f64::from(weight) / scale).round().clamp(-127.0, 127.0) as i8;
        let weights: Vec<i8> = self.weights.iter().map(round).collect();
        let lost = self.weights.iter().zip(&weights).zip(self.input_mean);
        let correction: f64 = lost
            .map(|((&weight, &stored), &mean)| {
                (f64::from(weight) - f64::from(stored) * scale) * f64::from(mean)
            })
            .sum();
        let sum: i64 = weights.iter().map(|&weight| i64::from(weight)).sum();
        let magnitude: i64 = weights.iter().map(|&weight| i64::from(weight).abs()).sum();
        let accumulator_scale = scale * self.input.scale / self.product_unit as f64;
        let real_bias = ((self.bias + correction) / accumulator_scale).round();
        let bias = real_bias as i64 - i64::from(self.input.zero_point) * sum * self.product_unit;
        let accumulator_max = magnitude * self.input.magnitude_max * self.product_unit + bias.abs();
        let fits = real_bias.abs() < 2f64.powi(31) && accumulator_max <= i64::from(i32::MAX);
        fits.then_some(Row { weights, bias: bias as i32, scale, accumulator_max })
    }
}

/// The scale at which the stored activations of a layer fit `range`.
///
/// Ranges of 16 bits are symmetric, with as much head room again for codes that calibration did not see: gates multiply
/// what is rare in one layer by what is rare in the next, and a bit of 16 is less than 8-bit weights can tell.
/// Ranges of 8 bits have no step to spare: the zero point moves so that all are used (ELU never falls below −1), and of
/// 64 ranges the one with the least mean square error wins, since clipping a rare extreme may cost less than coarser
/// steps.
pub fn activation_scale(observed: &Observed, range: (i16, i16)) -> InputScale {
    let (low, high) = (f64::from(range.0), f64::from(range.1));
    let (min, max) = (f64::from(observed.min), f64::from(observed.max));
    let magnitude_max = i64::from(range.0).abs().max(i64::from(range.1));
    if high - low > 1000.0 {
        let scale = (2.0 * max.max(-min) / high).max(SCALE_MIN);
        return InputScale { scale, zero_point: 0, magnitude_max };
    }
    let candidates = (1..=64).map(|step| {
        let scale = ((max * f64::from(step) / 64.0 - min) / (high - low)).max(SCALE_MIN);
        let zero_point = (low - min / scale).round().clamp(low, high) as i16;
        InputScale { scale, zero_point, magnitude_max }
    });
    let scored =
        candidates.map(|candidate| (rounding_error(&observed.values, candidate, range), candidate));
    let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(InputScale { scale: 1.0, zero_point: 0, magnitude_max }, |scored| scored.1)
}

/// Keeps a layer whose activations never move from dividing by zero.
const SCALE_MIN: f64 = 1e-9;

/// Sum of squares of what storing `values` loses.
fn rounding_error(values: &[f32], input: InputScale, range: (i16, i16)) -> f64 {
    let zero_point = f64::from(input.zero_point);
    let square = |&value: &f32| {
        let stored = (f64::from(value) / input.scale + zero_point).round();
        let stored = stored.clamp(f64::from(range.0), f64::from(range.1));
        ((stored - zero_point) * input.scale - f64::from(value)).powi(2)
    };
    values.iter().map(square).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn all_zero_row_keeps_its_bias() {
        let layer = DenseLayer {
            input_count: 3,
            output_count: 1,
            weights: vec![0.0; 3],
            bias: vec![-1.25],
        };
        let input = InputScale { scale: 1e-4, zero_point: 7, magnitude_max: 32_767 };
        let quantized = quantize_layer(&layer, input, &[], 1);
        let real = f64::from(quantized.bias[0]) * quantized.accumulator_scales[0];
        assert!((real + 1.25).abs() < 1e-6, "{real}");
    }

    #[test]
    fn row_that_would_overflow_gets_a_coarser_scale() {
        let layer = DenseLayer {
            input_count: 4096,
            output_count: 1,
            weights: vec![1.0; 4096],
            bias: vec![0.0],
        };
        let input = InputScale { scale: 1.0, zero_point: 0, magnitude_max: 32_768 };
        let quantized = quantize_layer(&layer, input, &[], 1);
        assert!(quantized.accumulator_use[0] < 1.0);
        assert!(quantized.weights[0] < 127 && quantized.weights[0] > 0);
    }

    proptest! {
        #[test]
        fn every_row_carries_its_certificate(
            weights in prop::collection::vec(-3.0f32..3.0, 1..300), bias in -100.0f32..100.0, zero_point in -128i16..128
        ) {
            let input = InputScale { scale: 0.01, zero_point, magnitude_max: 32_767 };
            let layer = DenseLayer { input_count: weights.len(), output_count: 1, weights, bias: vec![bias] };
            let row = quantize_layer(&layer, input, &[], 1);
            let magnitude: i64 = row.weights.iter().map(|&weight| i64::from(weight).abs()).sum();
            prop_assert!(magnitude * 32_767 + i64::from(row.bias[0]).abs() < 1 << 31);
        }
    }
}
