//! Station 6g: which layers may have 4-bit weights so that a blob fits the flash, at the least error.
//!
//! In:  a checkpoint and a number of bytes.
//! Out: a weight format for each layer, and the trade-off curve that the choice was made from.
//!
//! Each layer is once stored in 4 bits while all others keep 8; what that adds to the squared error of the poses is its
//! price. Prices add up (errors of different layers are nearly independent), and with at most ten layers all
//! combinations can be looked at. Predictions choose; the chosen blob is measured.

use std::fmt;

use indicatif::ProgressBar;
use karakuri::manifest::WeightFormat;
use karakuri::{Decoder, FramePosition, Model, NumberFormat, Pose, Workspace, limits};

use crate::error::{Error, Result};
use crate::quantize::calibrate::{CalibrationCase, decode_float};
use crate::quantize::{HiddenInputs, QuantizeInput, QuantizeOptions, Quantized, quantize_with};

/// Poses whose error is measured, at most.
const POSE_COUNT_MAX: usize = 240;
/// Poses of a case.
const FRAMES_PER_CASE: usize = 3;

/// One way to choose.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Choice {
    /// Bits of each layer's weights: code half, time half, the others.
    pub weight_bits: Vec<u8>,
    /// Of the blob.
    pub bytes: usize,
    /// RMS error of the channels, as a share of each channel's scale in the clips; predicted from single layers.
    pub error_predicted: f64,
}

/// The curve and the choice.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FlashBudget {
    /// Bytes allowed.
    pub bytes_max: usize,
    /// Choices that no other beats in both bytes and error, largest first.
    pub curve: Vec<Choice>,
    /// Index of the choice in `curve`.
    pub chosen: usize,
    /// RMS error of the chosen blob, measured.
    pub error_measured: f64,
}

impl FlashBudget {
    /// Bits of each layer's weights, as chosen.
    pub fn weight_bits(&self) -> &[u8] {
        &self.curve[self.chosen].weight_bits
    }
}

impl fmt::Display for FlashBudget {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "\nbits of each layer's weights (code half, time half, ...) in {} bytes",
            self.bytes_max
        )?;
        writeln!(out, "  {:>9}  {:>15}  bits", "bytes", "error predicted")?;
        for (index, choice) in self.curve.iter().enumerate() {
            let mark = if index == self.chosen { '>' } else { ' ' };
            let bits: Vec<String> = choice.weight_bits.iter().map(u8::to_string).collect();
            let percent = 100.0 * choice.error_predicted;
            writeln!(out, "{mark} {:>9}  {percent:>13.2} %  {}", choice.bytes, bits.join(" "))?;
        }
        let percent = 100.0 * self.error_measured;
        writeln!(
            out,
            "error: RMS over all channels, of each channel's scale in the clips; chosen, measured: {percent:.2} %"
        )
    }
}

/// Quantises to 8-bit activations with the weights that fit `bytes_max` at the least error.
///
/// # Errors
/// A budget that not even 4 bits in every layer meet, and the errors of `quantize`.
pub fn quantize_within(
    input: &QuantizeInput<'_>,
    options: &QuantizeOptions,
    bytes_max: usize,
    progress: &ProgressBar,
) -> Result<(Quantized, FlashBudget)> {
    let options = QuantizeOptions { format: NumberFormat::W4A8, ..options.clone() };
    let hidden = HiddenInputs::new(input, options.format)?;
    let cases = cases(input)?;
    let store = |weights: &[WeightFormat]| {
        let options = QuantizeOptions { weights: Some(weights.to_vec()), ..options.clone() };
        quantize_with(input, &options, &hidden)
    };
    // Layer 1 counts twice: its code half and its time half are layers of their own.
    let layer_count = input.model.layers.len() + 1;
    progress.set_length(layer_count as u64 + 2);
    let all_bytes = vec![WeightFormat::I8; layer_count];
    let widest = measure(input, &store(&all_bytes)?, &cases)?;
    let mut prices = Vec::with_capacity(layer_count);
    for layer in 0..layer_count {
        progress.inc(1);
        let mut weights = all_bytes.clone();
        weights[layer] = WeightFormat::I4;
        let narrow = measure(input, &store(&weights)?, &cases)?;
        prices.push(Price {
            bytes_saved: widest.bytes.saturating_sub(narrow.bytes),
            square: (narrow.error.powi(2) - widest.error.powi(2)).max(0.0),
        });
    }
    let curve = curve(&widest, &prices);
    let Some(chosen) = curve.iter().position(|choice| choice.bytes <= bytes_max) else {
        let least = curve.last().map_or(0, |choice| choice.bytes);
        return Err(Error::bad_input(
            input.name,
            "--flash",
            format!("{bytes_max} bytes"),
            format!("at least {least} bytes, which 4 bits in every layer take"),
            "train a smaller preset, or give more flash",
        ));
    };
    progress.inc(1);
    let bits = &curve[chosen].weight_bits;
    let weights: Vec<WeightFormat> = bits.iter().map(|&bits| weight_format(bits)).collect();
    let quantized = store(&weights)?;
    let error_measured = measure(input, &quantized, &cases)?.error;
    progress.finish_and_clear();
    Ok((quantized, FlashBudget { bytes_max, curve, chosen, error_measured }))
}

/// What 4 bits in one layer save and cost.
struct Price {
    bytes_saved: usize,
    /// Added to the mean square error.
    square: f64,
}

struct Measured {
    bytes: usize,
    error: f64,
}

/// The format of weights of so many bits.
pub fn weight_format(bits: u8) -> WeightFormat {
    if bits == 4 { WeightFormat::I4 } else { WeightFormat::I8 }
}

/// All combinations, less those that another beats; largest blob first.
fn curve(widest: &Measured, prices: &[Price]) -> Vec<Choice> {
    let combination = |narrow: usize| {
        let is_narrow = |layer: &usize| narrow >> layer & 1 == 1;
        let layers = || (0..prices.len()).filter(is_narrow);
        let square: f64 = layers().map(|layer| prices[layer].square).sum();
        let saved: usize = layers().map(|layer| prices[layer].bytes_saved).sum();
        Choice {
            weight_bits: (0..prices.len()).map(|l| if is_narrow(&l) { 4 } else { 8 }).collect(),
            bytes: widest.bytes.saturating_sub(saved),
            error_predicted: (widest.error.powi(2) + square).sqrt(),
        }
    };
    let mut all: Vec<Choice> = (0..1usize << prices.len()).map(combination).collect();
    all.sort_by(|a, b| a.error_predicted.total_cmp(&b.error_predicted).then(a.bytes.cmp(&b.bytes)));
    let mut front: Vec<Choice> = Vec::new();
    for choice in all {
        if front.last().is_none_or(|best| choice.bytes < best.bytes) {
            front.push(choice);
        }
    }
    front
}

/// Evenly spread over the clips and their mixture draws.
fn cases(input: &QuantizeInput<'_>) -> Result<Vec<CalibrationCase>> {
    let all = input.calibration_cases()?;
    let stride = (all.len() * FRAMES_PER_CASE).div_ceil(POSE_COUNT_MAX).max(1);
    let thinned = all.into_iter().step_by(stride).map(|case| {
        let spacing = case.frames.len().div_ceil(FRAMES_PER_CASE).max(1);
        let frames = case.frames.iter().copied().step_by(spacing).collect();
        CalibrationCase { frames, ..case }
    });
    Ok(thinned.collect())
}

/// RMS over channels and poses of (device − float) / scale.
fn measure(
    input: &QuantizeInput<'_>,
    quantized: &Quantized,
    cases: &[CalibrationCase],
) -> Result<Measured> {
    let refused = |reason: karakuri::BlobError| Error::Blob {
        path: input.name.into(),
        reason: reason.to_string(),
    };
    let model = Model::from_bytes(&quantized.blob).map_err(refused)?;
    let mut workspace = Box::new(Workspace::<{ limits::WIDTH_MAX }>::new());
    let mut decoder = Decoder::new(&model, &mut workspace).map_err(refused)?;
    let (mut pose, mut squares, mut count) = (Pose::new(), 0.0, 0usize);
    for case in cases {
        decoder.start(&model.code_from_f32(&case.code));
        for &frame in &case.frames {
            let position = FramePosition::from_bits((frame * 65_536.0).round() as u32);
            decoder.decode(position, &mut pose);
            let float = decode_float(input.model, &case.code, frame);
            let channels = pose.values().zip(&float).zip(&input.dataset.mean);
            for (((device, &float), &mean), &scale) in channels.zip(&input.dataset.scale) {
                let standardized = (device - f64::from(mean)) / f64::from(scale);
                squares += (standardized - f64::from(float)).powi(2);
                count += 1;
            }
        }
    }
    let error = (squares / count.max(1) as f64).sqrt();
    Ok(Measured { bytes: quantized.blob.len(), error })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prices() -> Vec<Price> {
        [(100, 1.0), (50, 4.0), (200, 0.5)]
            .map(|(bytes_saved, square)| Price { bytes_saved, square })
            .into()
    }

    #[test]
    fn curve_falls_in_bytes_as_it_rises_in_error() {
        let curve = curve(&Measured { bytes: 1000, error: 1.0 }, &prices());
        assert_eq!(curve[0].weight_bits, [8, 8, 8]);
        assert_eq!(curve.last().unwrap().weight_bits, [4, 4, 4]);
        for pair in curve.windows(2) {
            assert!(pair[0].bytes > pair[1].bytes);
            assert!(pair[0].error_predicted <= pair[1].error_predicted);
        }
    }

    #[test]
    fn layer_that_saves_little_at_a_high_price_comes_last() {
        let curve = curve(&Measured { bytes: 1000, error: 1.0 }, &prices());
        let first_with =
            |layer: usize| curve.iter().position(|choice| choice.weight_bits[layer] == 4).unwrap();
        assert!(first_with(2) < first_with(0) && first_with(0) < first_with(1));
    }
}
