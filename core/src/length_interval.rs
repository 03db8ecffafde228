//! The lengths of one action that share clips or a mixture.
//!
//! In:  records of the blob's table of intervals.
//! Out: their fields to `sampler.rs`.

use crate::manifest::INTERVAL_BYTES;

/// One stored length interval of one action; lengths are inclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Interval {
    pub action: u16,
    pub frames_min: u16,
    pub frames_max: u16,
    /// Factor on the shared noise, Q4.12.
    pub spread: u16,
    pub member_first: u32,
    pub member_count: u32,
}

impl Interval {
    pub fn parse(record: &[u8; INTERVAL_BYTES]) -> Self {
        let [a, b, c, d, e, f, g, h, first @ .., i, j, k, l] = *record;
        Self {
            action: u16::from_le_bytes([a, b]),
            frames_min: u16::from_le_bytes([c, d]),
            frames_max: u16::from_le_bytes([e, f]),
            spread: u16::from_le_bytes([g, h]),
            member_first: u32::from_le_bytes(first),
            member_count: u32::from_le_bytes([i, j, k, l]),
        }
    }

    pub fn contains(&self, frames: u32) -> bool {
        (u32::from(self.frames_min)..=u32::from(self.frames_max)).contains(&frames)
    }
}
