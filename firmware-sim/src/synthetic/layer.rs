//! One layer of a synthetic model: random weights, and the scales that go with them.
//!
//! In:  shape and place of the layer, a number format.
//! Out: bytes of its tensors.
//!
//! Why here: the only file of the benchmarks that knows how weights lie in a blob.
//! Source: `host-trainer/src/quantize/layer.rs`, for the meaning of every scale; here they follow from the spread of the
//! weights, not from data.

use half::f16;
use karakuri::manifest::{ActivationScale, CODE_LAYER, Manifest, TIME_LAYER};
use karakuri::{NumberFormat, Pcg32, Requantizer};

/// Fraction bits of the codes.
pub const CODE_FRACTION_BITS: u8 = 11;
/// Keeps the spread of pre-activations near 1 in spite of ELU, which narrows it.
const GAIN: f64 = 1.3;
/// Standard deviation of the biases.
const BIAS_DEVIATION: f64 = 0.1;
/// Real range of activations: ELU never falls below −1, and few sums of spread 1 exceed 4.
const ACTIVATION_RANGE: [f64; 2] = [-1.0, 4.0];
/// Standard deviation of stored integer weights: they reach the end of their range at 3.3 of it.
const STORED_DEVIATION: f64 = 127.0 / 3.3;
/// 1 of a pre-activation and of a pose, Q15.16.
const Q16: f64 = 65_536.0;

/// `real = scale · (stored − zero_point)`.
#[derive(Clone, Copy, Debug)]
struct Scale {
    scale: f64,
    zero_point: i16,
}

/// A layer before it is packed.
#[derive(Debug)]
pub struct Layer {
    format: NumberFormat,
    input: Scale,
    /// Real value of 1 of a stored weight.
    weight_scale: f64,
    /// What an accumulator's 1 is worth in the next format.
    factor: f64,
    /// Real. // (out, in)
    weights: Vec<f64>,
    /// Real; none in the time half. // (out)
    biases: Vec<f64>,
}

impl Layer {
    /// Draws the weights of one layer of the manifest.
    pub fn draw(manifest: &Manifest<'_>, index: usize, random: &mut Pcg32) -> Self {
        let format = manifest.number_format;
        let shape = manifest.layers[index];
        let (inputs, outputs) = (usize::from(shape.input_count), usize::from(shape.output_count));
        let deviation = weight_deviation(manifest, index);
        let weight_scale = deviation / STORED_DEVIATION;
        let input = input_scale(index, format);
        let next = match index {
            // The sum of the code half is continued by the time half, whose weights have the same spread.
            CODE_LAYER => input_scale(TIME_LAYER, format).scale * weight_scale,
            _ => 1.0 / Q16,
        };
        let bias_count = if index == TIME_LAYER { 0 } else { outputs };
        Self {
            format,
            input,
            weight_scale,
            factor: weight_scale * input.scale / next,
            weights: (0..inputs * outputs).map(|_| normal(random) * deviation).collect(),
            biases: (0..bias_count).map(|_| normal(random) * BIAS_DEVIATION).collect(),
        }
    }

    /// Weights as they lie in the blob.
    pub fn weights(&self) -> Vec<u8> {
        match self.format {
            NumberFormat::F16 => self
                .weights
                .iter()
                .flat_map(|&weight| f16::from_f64(weight).to_bits().to_le_bytes())
                .collect(),
            _ => self.stored_weights().map(i8::cast_unsigned).collect(),
        }
    }

    /// Biases, with the zero point of the inputs folded in.
    pub fn biases(&self) -> Vec<u8> {
        if self.format == NumberFormat::F16 {
            return self.biases.iter().flat_map(|&bias| (bias as f32).to_le_bytes()).collect();
        }
        let stored: Vec<i8> = self.stored_weights().collect();
        let inputs = stored.len() / self.biases.len().max(1);
        let zero_point = i32::from(self.input.zero_point);
        let rows = self.biases.iter().zip(stored.chunks_exact(inputs.max(1)));
        rows.flat_map(|(&bias, row)| {
            let sum: i32 = row.iter().map(|&weight| i32::from(weight)).sum();
            let bias = (bias / (self.weight_scale * self.input.scale)).round() as i32;
            (bias - zero_point * sum).to_le_bytes()
        })
        .collect()
    }

    /// One multiplier a row.
    pub fn multipliers(&self, row_count: usize) -> Vec<u8> {
        requantizer_of(self.factor).parts().0.to_le_bytes().repeat(row_count)
    }

    /// One shift a row.
    pub fn shifts(&self, row_count: usize) -> Vec<u8> {
        vec![requantizer_of(self.factor).parts().1.cast_unsigned(); row_count]
    }

    fn stored_weights(&self) -> impl Iterator<Item = i8> + '_ {
        let stored = |weight: &f64| (weight / self.weight_scale).round().clamp(-127.0, 127.0) as i8;
        self.weights.iter().map(stored)
    }
}

/// The scale of what a layer hands on, in the manifest's terms; none where no activation follows.
pub fn activation_of(index: usize, last: usize, format: NumberFormat) -> ActivationScale {
    if index == CODE_LAYER || index == last || format == NumberFormat::F16 {
        return ActivationScale::default();
    }
    let Scale { scale, zero_point } = activation_scale(format);
    let (multiplier, shift) = requantizer_of(1.0 / (Q16 * scale)).parts();
    ActivationScale { multiplier, shift, zero_point }
}

/// Symmetric where there are steps to spare, else the whole range of the format.
fn activation_scale(format: NumberFormat) -> Scale {
    let (low, high) = format.activation_range();
    let [min, max] = ACTIVATION_RANGE;
    if high > 1000 {
        return Scale { scale: max / f64::from(high), zero_point: 0 };
    }
    let scale = (max - min) / (f64::from(high) - f64::from(low));
    Scale { scale, zero_point: (f64::from(low) - min / scale).round() as i16 }
}

fn input_scale(index: usize, format: NumberFormat) -> Scale {
    match index {
        CODE_LAYER => Scale { scale: 1.0 / f64::from(1 << CODE_FRACTION_BITS), zero_point: 0 },
        TIME_LAYER => Scale { scale: 1.0 / f64::from(format.sinusoid_one()), zero_point: 0 },
        _ => activation_scale(format),
    }
}

/// Layer 1 adds up both of its halves.
fn weight_deviation(manifest: &Manifest<'_>, index: usize) -> f64 {
    let inputs = |index: usize| f64::from(manifest.layers[index].input_count);
    match index {
        CODE_LAYER | TIME_LAYER => GAIN / (inputs(CODE_LAYER) + inputs(TIME_LAYER)).sqrt(),
        _ => GAIN / inputs(index).sqrt(),
    }
}

/// The stored form of a positive factor, exact powers of two split off.
fn requantizer_of(factor: f64) -> Requantizer {
    let (mut mantissa, mut shift) = (factor, 0);
    while mantissa >= 1.0 {
        (mantissa, shift) = (mantissa / 2.0, shift + 1);
    }
    while mantissa < 0.5 {
        (mantissa, shift) = (mantissa * 2.0, shift - 1);
    }
    Requantizer::new((mantissa * 2_147_483_647.0) as i32, shift).unwrap_or(Requantizer::ZERO)
}

/// A number of mean 0 and standard deviation 1, nearly normal: the sum of four bytes.
pub fn normal(random: &mut Pcg32) -> f64 {
    let sum: u16 = random.next_u32().to_le_bytes().into_iter().map(u16::from).sum();
    // Four times the variance (256² − 1) / 12 of a byte.
    (f64::from(sum) - 510.0) / (4.0f64 * 65_535.0 / 12.0).sqrt()
}
