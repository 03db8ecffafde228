//! Bytes of one packet of a servo bus, in a buffer of the caller's.

use core::fmt;

/// The buffer has no room for the packet; 8 bytes a servo and 16 more are always enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferTooSmall {
    /// Bytes of the buffer.
    pub bytes: usize,
    /// Bytes of the packet.
    pub needed: usize,
}

impl fmt::Display for BufferTooSmall {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, needed } = self;
        write!(out, "a buffer of {bytes} bytes is too small for a packet of {needed}")
    }
}

impl core::error::Error for BufferTooSmall {}

/// A packet that is being written. Counts what does not fit, so that the error can say what would.
pub(super) struct Packet<'b> {
    buffer: &'b mut [u8],
    len: usize,
}

impl<'b> Packet<'b> {
    pub fn new(buffer: &'b mut [u8]) -> Self {
        Self { buffer, len: 0 }
    }

    pub fn push(&mut self, byte: u8) {
        self.set(self.len, byte);
        self.len += 1;
    }

    pub fn extend(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.push(byte));
    }

    /// Writes over a byte, if the buffer has it.
    pub fn set(&mut self, index: usize, byte: u8) {
        if let Some(place) = self.buffer.get_mut(index) {
            *place = byte;
        }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// What was written from `start` on and fits.
    pub fn since(&self, start: usize) -> &[u8] {
        self.buffer.get(start..self.len).unwrap_or_default()
    }

    pub fn finish(self) -> Result<&'b [u8], BufferTooSmall> {
        let error = BufferTooSmall { bytes: self.buffer.len(), needed: self.len };
        let buffer: &'b [u8] = self.buffer;
        buffer.get(..self.len).ok_or(error)
    }
}

/// Servos that get a pulse, with their numbers on the bus.
pub(super) fn driven<'a>(
    ids: &'a [u8],
    positions: &'a [u16],
) -> impl Iterator<Item = (u8, u16)> + Clone + 'a {
    let servos = ids.iter().copied().zip(positions.iter().copied());
    servos.filter(|&(_, position)| position != 0)
}

/// All servos, and whether they get a pulse.
pub(super) fn torques<'a>(
    ids: &'a [u8],
    positions: &'a [u16],
) -> impl Iterator<Item = (u8, [u8; 1])> + Clone + 'a {
    ids.iter().zip(positions).map(|(&id, &position)| (id, [u8::from(position != 0)]))
}
