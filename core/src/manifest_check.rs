//! What a manifest must satisfy before anything is cut out of the blob.
//!
//! Why here: the rest of the crate relies on these facts and checks none of them again.

use crate::error::BlobError;
use crate::kernel;
use crate::limits::{CHANNELS_MAX, CODE_MAX, NAMES_MAX, SINUSOIDS_MAX, WIDTH_MAX};
use crate::manifest::{CODE_LAYER, Manifest, NumberFormat, Packing, SamplerKind, TIME_LAYER};

/// Everything about a manifest that needs no tensor.
pub(crate) fn check(manifest: &Manifest<'_>, bytes: &[u8]) -> Result<(), BlobError> {
    check_build(manifest, bytes)?;
    check_limits(manifest)?;
    check_shapes(manifest)
}

/// Refuses, by name, what this build cannot decode.
fn check_build(manifest: &Manifest<'_>, bytes: &[u8]) -> Result<(), BlobError> {
    let format = manifest.number_format;
    if !format.is_built() {
        return Err(BlobError::FormatNotBuilt(format));
    }
    if !kernel::TAKES_ROWS && manifest.packing == Packing::Rows && format != NumberFormat::F16 {
        return Err(BlobError::PackedForAnotherKernel {
            packing: manifest.packing,
            family: kernel::FAMILY,
        });
    }
    let misalignment = bytes.as_ptr().addr() & (kernel::ALIGNMENT - 1);
    if misalignment != 0 {
        return Err(BlobError::Misaligned { misalignment, alignment: kernel::ALIGNMENT });
    }
    Ok(())
}

fn check_limits(manifest: &Manifest<'_>) -> Result<(), BlobError> {
    let widest =
        manifest.layers.iter().map(|shape| shape.input_count.max(shape.output_count)).max();
    let channels = manifest.layers.last().map_or(0, |shape| shape.output_count);
    let code_count =
        u32::from(manifest.sequence_code_count) + u32::from(manifest.action_code_count);
    let limited = [
        ("groups", u32::from(manifest.group_count), NAMES_MAX),
        ("actions", u32::from(manifest.action_count), NAMES_MAX),
        ("joints", u32::from(manifest.joint_count), NAMES_MAX),
        ("numbers of a code", code_count, CODE_MAX),
        ("sinusoids", 2 * u32::from(manifest.frequency_count), SINUSOIDS_MAX),
        ("channels", u32::from(channels), CHANNELS_MAX),
        ("layer width", u32::from(widest.unwrap_or(0)), WIDTH_MAX),
        ("code fraction bits", u32::from(manifest.code_fraction_bits), 15),
        ("components", manifest.sampler.component_count, u16::MAX as usize),
        ("step towards a neighbour", manifest.sampler.step_max_q16, 1 << 16),
        ("time table shift", u32::from(manifest.time_table_shift), 15),
    ];
    match limited.iter().find(|&&(_, value, max)| value as usize > max) {
        Some(&(field, value, max)) => Err(BlobError::OverLimit { field, value, max: max as u32 }),
        None => Ok(()),
    }
}

/// Every layer must take what the one before it gives.
fn check_shapes(manifest: &Manifest<'_>) -> Result<(), BlobError> {
    let bad = |field, value: usize| Err(BlobError::BadField { field, value: value as u32 });
    let code_count = manifest.sequence_code_count + manifest.action_code_count;
    let layers = &manifest.layers;
    let (Some(code_layer), Some(time_layer)) = (layers.get(CODE_LAYER), layers.get(TIME_LAYER))
    else {
        return bad("layers", layers.len());
    };
    if layers.len() < 3 {
        return bad("layers", layers.len());
    }
    if let Some(index) =
        layers.iter().position(|shape| shape.input_count == 0 || shape.output_count == 0)
    {
        return bad("empty layer", index);
    }
    if code_layer.input_count != code_count || !manifest.code_rows_suit() {
        return bad("shape of layer", CODE_LAYER);
    }
    if manifest.has_phases() && manifest.time_table_frames != 0 {
        return bad("time table of a model with phases", manifest.time_table_frames.into());
    }
    if time_layer.input_count != 2 * manifest.frequency_count {
        return bad("shape of layer", TIME_LAYER);
    }
    let pairs = layers.iter().zip(layers.iter().skip(1)).enumerate().skip(TIME_LAYER);
    for (index, (layer, next)) in pairs {
        if layer.output_count != next.input_count {
            return bad("shape of layer", index + 1);
        }
    }
    if manifest.rate_millihz == 0 {
        return bad("rate", 0);
    }
    let sampler = &manifest.sampler;
    match sampler.kind {
        SamplerKind::DiagonalMixture if sampler.step_max_q16 != 0 => {
            bad("step of a diagonal mixture", sampler.step_max_q16 as usize)
        }
        SamplerKind::NearestClips { clip_count: 0, .. } => bad("nearest clips", 0),
        SamplerKind::NearestClips { .. } if sampler.member_count != 0 => {
            bad("members of nearest clips", sampler.member_count as usize)
        }
        _ => Ok(()),
    }
}
