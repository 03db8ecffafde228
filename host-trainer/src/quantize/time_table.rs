//! Station 6f: what the time half adds to layer 1, for every whole frame; saves its work at the price of flash.
//!
//! Why here: made by the device's own arithmetic, so that a frame looked up and a frame computed differ by the rounding
//! of the table alone: at most half of 2^-15 of the largest product, a unit of the accumulator's upper 16 bits.

use karakuri::{Decoder, FramePosition, Model, NumberFormat, Workspace, limits};

use crate::error::{Error, Result};

/// Products of the time half.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeTable {
    /// Whole frames, from 0.
    pub frames: u16,
    /// Products are entries · 2^shift.
    pub shift: u8,
    /// // (frame, out)
    entries: Vec<i16>,
}

impl TimeTable {
    /// Little-endian.
    pub fn bytes(&self) -> Vec<u8> {
        self.entries.iter().flat_map(|entry| entry.to_le_bytes()).collect()
    }
}

/// The table of the first `frames` frames.
///
/// # Errors
/// `f16` has no time table.
pub fn time_table(model: &Model<'_>, frames: u16) -> Result<TimeTable> {
    if model.number_format() == NumberFormat::F16 {
        return Err(Error::bad_input(
            "--time-table",
            "format",
            "f16",
            "an integer format",
            "leave --time-table away, or quantise to w8a16, w8a8 or w4a8",
        ));
    }
    if model.manifest().has_phases() {
        return Err(Error::bad_input(
            "--time-table",
            "decoder.modulation",
            "gates-and-phases",
            "none or gates: phases make the time half another one for every motion",
            "leave --time-table away, or train with modulation = \"gates\"",
        ));
    }
    let mut workspace = Box::new(Workspace::<{ limits::WIDTH_MAX }>::new());
    let mut decoder = Decoder::new(model, &mut workspace)
        .map_err(|reason| Error::Blob { path: "time table".into(), reason: reason.to_string() })?;
    let mut products = Vec::new();
    for frame in 0..u32::from(frames) {
        let position = FramePosition::from_frames(frame);
        decoder.time_products(position, |four| products.extend(four));
    }
    let largest = products.iter().map(|product| product.unsigned_abs()).max().unwrap_or(0);
    // The smallest shift at which the largest product, rounded, fits 16 bits.
    let shift = (0..15u8).find(|&shift| largest >> shift < 32_767).unwrap_or(15);
    let half = (1i64 << shift) >> 1;
    let entry =
        |&product: &i32| ((i64::from(product) + half) >> shift).clamp(-32_768, 32_767) as i16;
    Ok(TimeTable { frames, shift, entries: products.iter().map(entry).collect() })
}
