//! Bytes of a line → frames that are whole, unchanged, of a known version and meant for this side.
//!
//! Why here: stuffing is undone byte by byte, so only what a frame contains is stored, in a buffer whose size the
//! application chooses.

use super::{CHECKSUM_BYTES, Command, FROM_CHIP, HEAD_BYTES, LinkError, PROTOCOL_VERSION, Report};
use crate::crc32::crc32;

/// Cuts a stream of bytes into frames. `N` bytes, see [`receiver_bytes`](super::receiver_bytes), and a dozen more.
#[derive(Clone, Debug)]
pub struct Receiver<const N: usize> {
    bytes: [u8; N],
    len: usize,
    /// Bytes of the present block that are still to come.
    block_left: u8,
    /// The present block stands for a zero after it, unless the frame ends there.
    owes_zero: bool,
    is_begun: bool,
}

/// A frame that arrived as it was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    is_from_chip: bool,
    sequence: u16,
    message: &'a [u8],
}

impl<'a> Frame<'a> {
    /// The number that its sender gave it.
    pub fn sequence(&self) -> u16 {
        self.sequence
    }

    /// What a host commands.
    ///
    /// # Errors
    /// [`LinkError::WrongDirection`] where a chip sent it, [`LinkError::UnknownMessage`].
    pub fn command(&self) -> Result<Command<'a>, LinkError> {
        if self.is_from_chip {
            return Err(LinkError::WrongDirection);
        }
        Command::parse(self.message)
    }

    /// What a chip reports.
    ///
    /// # Errors
    /// [`LinkError::WrongDirection`] where a host sent it, [`LinkError::UnknownMessage`].
    pub fn report(&self) -> Result<Report, LinkError> {
        if !self.is_from_chip {
            return Err(LinkError::WrongDirection);
        }
        Report::parse(self.message)
    }

    /// Checks what stands between two zeros, stuffing undone.
    fn from_content(content: &'a [u8]) -> Result<Self, LinkError> {
        let Some((checked, stored)) = content.split_last_chunk::<CHECKSUM_BYTES>() else {
            return Err(LinkError::Cut);
        };
        let Some((&[version, low, high], message)) = checked.split_first_chunk::<HEAD_BYTES>()
        else {
            return Err(LinkError::Cut);
        };
        let (stored, computed) = (u32::from_le_bytes(*stored), crc32([checked]));
        if stored != computed {
            return Err(LinkError::WrongChecksum { stored, computed });
        }
        let (found, newest) = (version & !FROM_CHIP, PROTOCOL_VERSION);
        if found > newest {
            return Err(LinkError::NewerVersion { found, newest });
        }
        if found == 0 {
            return Err(LinkError::UnknownMessage);
        }
        let sequence = u16::from_le_bytes([low, high]);
        Ok(Self { is_from_chip: version & FROM_CHIP != 0, sequence, message })
    }
}

impl<const N: usize> Default for Receiver<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Receiver<N> {
    /// A receiver that has heard nothing.
    pub const fn new() -> Self {
        Self { bytes: [0; N], len: 0, block_left: 0, owes_zero: false, is_begun: false }
    }

    /// Takes the next byte of the line. Something comes back where a frame ends there: the frame, which must be used
    /// before the next byte, or what is wrong with it.
    ///
    /// # Errors
    /// Every [`LinkError`] of a frame. The next frame is received all the same.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, LinkError>> {
        if byte == 0 {
            return self.end();
        }
        self.is_begun = true;
        if self.block_left > 0 {
            self.store(byte);
            self.block_left -= 1;
        } else {
            if self.owes_zero {
                self.store(0);
            }
            self.block_left = byte - 1;
            self.owes_zero = byte != u8::MAX;
        }
        None
    }

    /// Counts on past the end, so that the length tells what did not fit.
    fn store(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(self.len) {
            *place = byte;
        }
        self.len = self.len.saturating_add(1);
    }

    fn end(&mut self) -> Option<Result<Frame<'_>, LinkError>> {
        let (len, is_begun, is_cut) = (self.len, self.is_begun, self.block_left > 0);
        (self.len, self.block_left, self.owes_zero, self.is_begun) = (0, 0, false, false);
        if !is_begun {
            return None;
        }
        let Some(content) = self.bytes.get(..len) else {
            return Some(Err(LinkError::TooLong { max: u32::try_from(N).unwrap_or(u32::MAX) }));
        };
        Some(if is_cut { Err(LinkError::Cut) } else { Frame::from_content(content) })
    }
}

#[cfg(test)]
mod tests;
