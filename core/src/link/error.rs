//! What can be wrong with a frame. Nothing of such a frame is acted upon.

use core::fmt;

use serde::{Deserialize, Serialize};

/// Why a frame was refused, or could not be written. Chips report these to the host, so variants are only ever added
/// at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LinkError {
    /// The frame ends before it is whole: bytes were lost on the line, or the sender was reset. Send it again.
    Cut,
    /// The frame is longer than the receiver's buffer, or a zero byte between two frames was lost. Send it again, or
    /// shorter chunks.
    TooLong {
        /// Bytes that the receiver has room for, stuffing not counted.
        max: u32,
    },
    /// The checksum does not fit: bytes changed on the line. Send it again.
    WrongChecksum {
        /// CRC-32 in the frame.
        stored: u32,
        /// CRC-32 of what arrived.
        computed: u32,
    },
    /// The sender speaks a newer protocol. Update this side, or use the other as it was when this side was made.
    NewerVersion {
        /// Version of the frame.
        found: u8,
        /// Newest version that is understood.
        newest: u8,
    },
    /// A frame that the other side should have received: the line echoes, or both ends believe to be the host.
    WrongDirection,
    /// The checksum fits but this is no message of this version. The sender is made by something else than karakuri.
    UnknownMessage,
    /// The buffer to write a frame into is too small; see [`frame_bytes_max`](super::frame_bytes_max).
    BufferTooSmall {
        /// Bytes of the buffer.
        bytes: u32,
    },
}

impl fmt::Display for LinkError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Cut => out.write_str("the frame ends before it is whole"),
            Self::TooLong { max } => write!(out, "the frame is longer than {max} bytes"),
            Self::WrongChecksum { stored, computed } => {
                write!(out, "checksum {computed:08x} differs from the frame's {stored:08x}")
            }
            Self::NewerVersion { found, newest } => {
                write!(out, "protocol version {found} is newer than {newest}")
            }
            Self::WrongDirection => out.write_str("the frame was meant for the other side"),
            Self::UnknownMessage => out.write_str("not a message of this protocol version"),
            Self::BufferTooSmall { bytes } => {
                write!(out, "a buffer of {bytes} bytes is too small for the frame")
            }
        }
    }
}

impl core::error::Error for LinkError {}
