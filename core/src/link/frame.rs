//! A message → the bytes of one frame.
//!
//! Why here: checksum and stuffing are worked out while `postcard` writes, so no second buffer is needed.

use postcard::ser_flavors::Flavor;
use serde::Serialize;

use super::{CHECKSUM_BYTES, Command, FROM_CHIP, HEAD_BYTES, LinkError, PROTOCOL_VERSION, Report};
use crate::crc32::Crc32;

/// Bytes of a frame on the line, at most, whose message has `message_bytes`.
pub const fn frame_bytes_max(message_bytes: usize) -> usize {
    let content = HEAD_BYTES + message_bytes + CHECKSUM_BYTES;
    let stuffing = content / BLOCK_BYTES_MAX + 1;
    content + stuffing + 2
}

/// Longest run without a zero that one code byte describes.
const BLOCK_BYTES_MAX: usize = 254;

impl Command<'_> {
    /// Writes the command as one frame into `buffer`; returns the part that was filled.
    ///
    /// # Errors
    /// [`LinkError::BufferTooSmall`].
    pub fn encode<'b>(&self, sequence: u16, buffer: &'b mut [u8]) -> Result<&'b [u8], LinkError> {
        encode(self, PROTOCOL_VERSION, sequence, buffer)
    }
}

impl Report {
    /// Writes the report as one frame into `buffer`; returns the part that was filled. `sequence` counts the chip's
    /// reports, so that the host sees what was lost.
    ///
    /// # Errors
    /// [`LinkError::BufferTooSmall`].
    pub fn encode<'b>(&self, sequence: u16, buffer: &'b mut [u8]) -> Result<&'b [u8], LinkError> {
        encode(self, PROTOCOL_VERSION | FROM_CHIP, sequence, buffer)
    }
}

pub(super) fn encode<'b>(
    message: &impl Serialize,
    version: u8,
    sequence: u16,
    buffer: &'b mut [u8],
) -> Result<&'b [u8], LinkError> {
    let bytes = u32::try_from(buffer.len()).unwrap_or(u32::MAX);
    let mut writer = FrameWriter::new(buffer);
    let [low, high] = sequence.to_le_bytes();
    for byte in [version, low, high] {
        writer.push(byte);
    }
    // Nothing in these messages but a full buffer can fail.
    postcard::serialize_with_flavor(message, writer)
        .map_err(|_| LinkError::BufferTooSmall { bytes })
}

/// Stuffs bytes so that only the frame's ends are zero.
struct FrameWriter<'b> {
    out: &'b mut [u8],
    len: usize,
    is_full: bool,
    /// Where the present block's code will stand.
    code_at: usize,
    /// Bytes of the present block and one.
    code: u8,
    crc: Crc32,
}

impl<'b> FrameWriter<'b> {
    fn new(out: &'b mut [u8]) -> Self {
        let mut writer =
            Self { out, len: 0, is_full: false, code_at: 0, code: 1, crc: Crc32::new() };
        writer.write(0);
        writer.open_block();
        writer
    }

    fn push(&mut self, byte: u8) {
        self.crc.update(byte);
        self.stuff(byte);
    }

    fn stuff(&mut self, byte: u8) {
        if byte != 0 {
            self.write(byte);
            self.code += 1;
        }
        if byte == 0 || usize::from(self.code) > BLOCK_BYTES_MAX {
            self.close_block();
            self.open_block();
        }
    }

    fn open_block(&mut self) {
        self.code_at = self.len;
        self.code = 1;
        self.write(0);
    }

    fn close_block(&mut self) {
        match self.out.get_mut(self.code_at) {
            Some(code) => *code = self.code,
            None => self.is_full = true,
        }
    }

    fn write(&mut self, byte: u8) {
        match self.out.get_mut(self.len) {
            Some(place) => *place = byte,
            None => self.is_full = true,
        }
        self.len += 1;
    }
}

impl<'b> Flavor for FrameWriter<'b> {
    type Output = &'b [u8];

    // Called for every field: inlined, both would make the writer of reports five times as large.
    #[inline(never)]
    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        bytes.iter().for_each(|&byte| self.push(byte));
        Ok(())
    }

    #[inline(never)]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.push(byte);
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<&'b [u8]> {
        for byte in self.crc.value().to_le_bytes() {
            self.stuff(byte);
        }
        self.close_block();
        self.write(0);
        let is_full = self.is_full;
        let out: &'b [u8] = self.out;
        out.get(..self.len).filter(|_| !is_full).ok_or(postcard::Error::SerializeBufferFull)
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::crc32::crc32;

    #[test]
    fn buffer_that_is_too_small_is_refused_by_name() {
        let mut buffer = [0xAA; 64];
        for bytes in 0..10 {
            let refused = Command::Hold.encode(7, &mut buffer[..bytes as usize]);
            assert_eq!(refused, Err(LinkError::BufferTooSmall { bytes }));
        }
    }

    #[test]
    fn hold_is_these_bytes() {
        let mut buffer = [0; 32];
        let frame = Command::Hold.encode(0x0102, &mut buffer).unwrap();
        let content = [1, 2, 1, 2];
        let [a, b, c, d] = crc32([content.as_slice()]).to_le_bytes();
        assert_eq!(frame, [0, 9, 1, 2, 1, 2, a, b, c, d, 0]);
    }

    proptest! {
        #[test]
        fn stuffing_is_that_of_the_cobs_crate(
            bytes in prop::collection::vec(prop_oneof![Just(0_u8), any::<u8>()], 0..700)
        ) {
            let mut buffer = [0; 1024];
            let chunk = Command::LoadChunk { offset: 0, bytes: &bytes };
            let frame = chunk.encode(3, &mut buffer).unwrap();
            prop_assert!(frame.len() <= frame_bytes_max(bytes.len() + super::super::CHUNK_HEAD_BYTES_MAX));
            let stuffed = &frame[1..frame.len() - 1];
            prop_assert!(!stuffed.contains(&0));
            let mut content: Vec<u8> = stuffed.to_vec();
            let len = cobs::decode_in_place(&mut content).unwrap();
            let (checked, crc) = content[..len].split_at(len - 4);
            prop_assert_eq!(crc32([checked]).to_le_bytes(), crc);
            prop_assert!(checked.ends_with(&bytes));
        }
    }
}
