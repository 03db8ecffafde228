//! The link: commands from a host to the body, reports back, over any line that carries bytes.
//!
//! In:  bytes of a serial line, one by one; commands of whoever directs the body.
//! Out: [`Command`]s in their order, never twice, to the player; [`Report`]s as bytes to the host.
//!
//! ```text
//! frame on the line:  0 · COBS( version · sequence, 2 bytes · message, postcard · CRC-32, 4 bytes ) · 0
//! ```
//!
//! All numbers are little-endian. The version's highest bit says the direction, so that an echo is not obeyed. The
//! zeros at both ends make a receiver ready for the next frame whatever came before it. Messages are only ever added
//! at the end of their list, and a frame of a newer version is refused whole: nobody acts on half of what was meant.
//!
//! Why here: what moves a body must be told apart from noise by one piece of code, the same on chip and host. Nothing
//! of it is in an image that does not use it.
//! Source: Cheshire and Baker, Consistent Overhead Byte Stuffing, 1999; postcard wire format 1.0.

mod error;
mod frame;
mod inbox;
mod loader;
mod message;
mod performer;
mod receiver;

pub use error::LinkError;
pub use frame::frame_bytes_max;
pub use inbox::{Arrival, Inbox};
pub use loader::{BlobSink, Loader, SinkError, blob_crc};
pub use message::{Command, DialSettings, Mode, Play, Refusal, Report};
pub use performer::Performer;
pub use receiver::{Frame, Receiver};

/// Version of the frames and messages that this crate writes and reads.
pub const PROTOCOL_VERSION: u8 = 1;

/// Set in the version of what a chip sends.
const FROM_CHIP: u8 = 0x80;

/// Bytes of a frame before its message: version and sequence.
const HEAD_BYTES: usize = 3;

/// Bytes of a frame after its message.
const CHECKSUM_BYTES: usize = 4;

/// Bytes of the longest command but [`Command::LoadChunk`], as a message.
pub const COMMAND_BYTES_MAX: usize = 23;

/// Bytes of a [`Command::LoadChunk`] more than it carries, at most (chunks of up to 16,383 bytes).
pub const CHUNK_HEAD_BYTES_MAX: usize = 8;

/// Bytes of the longest report, as a message: telemetry of all servos.
pub const REPORT_BYTES_MAX: usize = 113;

/// Bytes that a [`Receiver`] needs for messages of `message_bytes`.
pub const fn receiver_bytes(message_bytes: usize) -> usize {
    HEAD_BYTES + message_bytes + CHECKSUM_BYTES
}
