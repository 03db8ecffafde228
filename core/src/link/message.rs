//! What host and chip tell each other.
//!
//! Why here: `serde` writes both and reads reports, which only a host does. Commands are read by hand, as
//! descriptions of a blob are: `serde`'s reader would add 1.2 KB to 4.5 KB of receiver, commands, loader and reports
//! (Cortex-M0+).

use serde::{Deserialize, Serialize};

use super::LinkError;
use crate::descriptions::Reader;
use crate::limits::SERVOS_MAX;

/// Host to chip. Variants are only ever added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(Deserialize))]
#[non_exhaustive]
pub enum Command<'a> {
    /// Begins a session: the commands that follow are numbered from this one. Answered by [`Report::Hello`].
    Hello,
    /// A motion, now or after the present one.
    Play(Play),
    /// Decelerate and stand still, wherever that is.
    Hold,
    /// Finish gently, then stand still.
    SoftStop,
    /// Release all servos at once.
    Relax,
    /// Servos on, softly, from the park pose.
    Wake,
    /// Forget a latched fault. Refused while its cause persists.
    ClearFault,
    /// How to move from now on.
    SetDials(DialSettings),
    /// A new blob will follow, of so many bytes.
    LoadBegin {
        /// Bytes of the whole blob file.
        len_bytes: u32,
        /// CRC-32 of all of them.
        crc: u32,
    },
    /// The next bytes of the blob.
    LoadChunk {
        /// Bytes before these.
        offset: u32,
        /// At most as many as [`Report::Hello`] allows.
        bytes: &'a [u8],
    },
    /// All bytes were sent: check them and use them.
    LoadCommit,
    /// Answered by [`Report::State`].
    Query,
    /// Live on between motions, by these actions; by none, stand still.
    Idle {
        /// Bit i: action i; actions from number 64 on cannot be chosen.
        actions: u64,
    },
    /// Go on after [`Command::Hold`].
    Resume,
}

/// A motion to play.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Play {
    /// Index of the action.
    pub action: u16,
    /// Length, milliseconds.
    pub duration_ms: u32,
    /// The same seed gives the same motion.
    pub seed: u64,
    /// How long the way into the motion may take, milliseconds.
    pub transition_ms: u16,
    /// After the present motion rather than in its place.
    pub then: bool,
}

/// How to move, each Q4.12: 4096 is 1; see [`Dials`](crate::Dials).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DialSettings {
    /// Distance from the action's mean motion.
    pub intensity_q12: u16,
    /// Speed of time.
    pub rate_q12: u16,
    /// Share of the time that an idle body rests.
    pub stillness_q12: u16,
    /// Temperature of the draw.
    pub variety_q12: u16,
}

/// Chip to host. Variants are only ever added at the end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Report {
    /// After a reset, and in answer to [`Command::Hello`].
    Hello {
        /// Beginning of the hash of the configuration that the model was trained with; zeros without one.
        model_hash: [u8; 8],
        /// Actions of the model.
        action_count: u16,
        /// Servos of the calibration.
        servo_count: u8,
        /// Longest [`Command::LoadChunk`]; 0 where blobs cannot be loaded.
        chunk_bytes_max: u16,
    },
    /// The command of this number was obeyed, now or when it came first.
    Ack {
        /// Number of the command.
        sequence: u16,
    },
    /// The command of this number was not obeyed.
    Refused {
        /// Number of the command.
        sequence: u16,
        /// Why.
        reason: Refusal,
    },
    /// Something came that is no command.
    Broken {
        /// What is wrong with it.
        error: LinkError,
    },
    /// What the body is doing.
    State {
        /// In one word.
        mode: Mode,
        /// The action that is played.
        action: Option<u16>,
    },
    /// A fault was latched: the body decelerates and holds until the fault is cleared.
    Fault {
        /// [`Fault::code`](crate::Fault::code).
        code: u16,
    },
    /// What was commanded at one tick.
    Telemetry {
        /// Ticks since the reset.
        tick: u32,
        /// How often a limit intervened since the reset.
        interventions: u32,
        /// Frames that were refused since the reset.
        broken_frames: u32,
        /// Pulse of every servo, microseconds; 0: released.
        pulses_us: heapless::Vec<u16, SERVOS_MAX>,
    },
}

/// What a body is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Mode {
    /// Servos are released.
    Relaxed,
    /// Between motions.
    Resting,
    /// An action is played, by command or of the body's own choice.
    Playing,
    /// Stands still until woken.
    Holding,
    /// A fault is latched: stands still until it is cleared.
    Faulted,
}

/// Why a command was not obeyed. Variants are only ever added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Refusal {
    /// The chip was reset, or the host never said hello. Say [`Command::Hello`].
    NoSession,
    /// A command in between was lost. Send that one first.
    OutOfOrder {
        /// Number of the command that is missing.
        expected: u16,
    },
    /// The message is none of this protocol version.
    UnknownMessage,
    /// The model has no such action.
    UnknownAction {
        /// Actions that it has.
        count: u16,
    },
    /// The length of the motion is none that can be played.
    BadDuration,
    /// A dial is outside its range.
    BadDials,
    /// Too many motions wait already.
    QueueFull,
    /// A fault is latched. Clear it first.
    Faulted {
        /// Code of the fault.
        code: u16,
    },
    /// The servos are released. Send [`Command::Wake`] first.
    Asleep,
    /// Blobs are loaded while servos are released. Send [`Command::Relax`] first.
    NotRelaxed,
    /// This firmware cannot do that.
    NotSupported,
    /// No [`Command::LoadBegin`] came before.
    NotBegun,
    /// Bytes of the blob are missing, came twice, or are more than were announced.
    WrongOffset {
        /// Bytes received so far.
        expected: u32,
    },
    /// The blob is larger than the room for it.
    BlobTooLarge,
    /// The blob's bytes are not those that were announced.
    WrongChecksum,
    /// The blob arrived whole but cannot be used by this firmware.
    BadBlob,
    /// The flash could not be written.
    FlashFailed,
}

impl<'a> Command<'a> {
    /// Reads the message of a frame.
    ///
    /// # Errors
    /// [`LinkError::UnknownMessage`].
    pub(super) fn parse(message: &'a [u8]) -> Result<Self, LinkError> {
        let mut reader = Reader::new(message);
        let command = match reader.variant(14) {
            0 => Self::Hello,
            1 => Self::Play(Play {
                action: reader.u16(),
                duration_ms: reader.u32(),
                seed: reader.varint(),
                transition_ms: reader.u16(),
                then: reader.variant(2) == 1,
            }),
            2 => Self::Hold,
            3 => Self::SoftStop,
            4 => Self::Relax,
            5 => Self::Wake,
            6 => Self::ClearFault,
            7 => Self::SetDials(DialSettings {
                intensity_q12: reader.u16(),
                rate_q12: reader.u16(),
                stillness_q12: reader.u16(),
                variety_q12: reader.u16(),
            }),
            8 => Self::LoadBegin { len_bytes: reader.u32(), crc: reader.u32() },
            9 => Self::LoadChunk { offset: reader.u32(), bytes: reader.bytes() },
            10 => Self::LoadCommit,
            11 => Self::Query,
            12 => Self::Idle { actions: reader.varint() },
            _ => Self::Resume,
        };
        let is_whole = !reader.is_broken() && reader.rest().is_empty();
        is_whole.then_some(command).ok_or(LinkError::UnknownMessage)
    }

    /// Whether the command is obeyed whatever its number is: stopping and asking must not wait for what was lost.
    pub(super) fn is_always_obeyed(&self) -> bool {
        matches!(self, Self::Hold | Self::SoftStop | Self::Relax | Self::Query)
    }
}

impl Report {
    /// Reads the message of a frame.
    ///
    /// # Errors
    /// [`LinkError::UnknownMessage`].
    pub(super) fn parse(message: &[u8]) -> Result<Self, LinkError> {
        match postcard::take_from_bytes(message) {
            Ok((report, [])) => Ok(report),
            _ => Err(LinkError::UnknownMessage),
        }
    }
}
