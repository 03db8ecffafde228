//! What can be wrong with a blob, a request or a servo's calibration; nothing else in this crate can fail.

use core::fmt;

use crate::manifest::{NumberFormat, Packing};
use crate::servo_map::ServoLimits;

/// Why a blob cannot be used. After `Model::from_bytes` has succeeded only
/// [`WorkspaceTooSmall`](Self::WorkspaceTooSmall) remains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BlobError {
    /// Fewer or more bytes than the header promises. Check the download, or the size of the flash region.
    WrongLength {
        /// Bytes given.
        found: usize,
        /// Bytes that the header promises (at least the header itself).
        expected: usize,
    },
    /// The first four bytes are not `KRKR`. This is no blob, or it starts elsewhere.
    WrongMagic,
    /// Written by a newer host-trainer. Update this crate, or quantise again with the older one.
    NewerVersion {
        /// Version of the blob.
        found: u16,
        /// Newest version that this crate reads.
        newest: u16,
    },
    /// Written by an older host-trainer, in a layout that the kernels no longer read. Quantise the run again.
    OlderVersion {
        /// Version of the blob.
        found: u16,
        /// Oldest version that this crate reads.
        oldest: u16,
    },
    /// The checksum does not fit: the bytes changed since they were written. Flash the blob again.
    WrongChecksum {
        /// CRC-32 in the header.
        stored: u32,
        /// CRC-32 of the bytes.
        computed: u32,
    },
    /// A field of the manifest is not what it has to be. The file was made by something else than host-trainer.
    BadField {
        /// Name of the field.
        field: &'static str,
        /// Its value, or its position where it is one of many.
        value: u32,
    },
    /// Larger than this crate's limits (see [`limits`](crate::limits)). Train a smaller preset.
    OverLimit {
        /// What is too large.
        field: &'static str,
        /// How large it is.
        value: u32,
        /// How large it may be.
        max: u32,
    },
    /// A row's accumulator could overflow: the quantiser's certificate does not hold. Quantise again.
    AccumulatorOverflow {
        /// Index of the layer.
        layer: usize,
        /// Index of the row.
        row: usize,
    },
    /// This build cannot decode the number format. Switch the crate's feature on, or quantise to another format.
    FormatNotBuilt(NumberFormat),
    /// Two frames in one pass need tiles of 8-bit weights in every layer. Use a `Decoder` twice.
    NoPairKernel(NumberFormat),
    /// The weights lie in an order that this build's kernels do not read. Quantise again with `--packing tiles`, which
    /// every build reads, or switch the crate's feature `portable` on.
    PackedForAnotherKernel {
        /// Order of the weights.
        packing: Packing,
        /// Kernels of this build.
        family: &'static str,
    },
    /// The assembly kernels load whole words. Put the blob into a `#[repr(align(16))]` wrapper.
    Misaligned {
        /// Bytes past the last aligned address.
        misalignment: usize,
        /// Alignment that is needed, in bytes.
        alignment: usize,
    },
    /// The calibration of a servo is unusable. Correct it and put it into the blob again (`host-trainer calibrate`).
    BadServo {
        /// Index of the servo.
        servo: u16,
        /// What is wrong with it.
        error: ServoError,
    },
    /// The workspace is narrower than the widest layer.
    WorkspaceTooSmall {
        /// Width of the workspace.
        width: usize,
        /// Width that the model needs.
        needed: usize,
    },
}

impl fmt::Display for BlobError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::WrongLength { found, expected } => {
                write!(out, "the blob is {found} bytes long, expected {expected}")
            }
            Self::WrongMagic => {
                out.write_str("the first four bytes are not KRKR: not a karakuri blob")
            }
            Self::NewerVersion { found, newest } => {
                write!(
                    out,
                    "format version {found} is newer than {newest}, the newest that is understood"
                )
            }
            Self::OlderVersion { found, oldest } => {
                write!(
                    out,
                    "format version {found} is older than {oldest}, the oldest that is understood: \
                     quantise the run again"
                )
            }
            Self::WrongChecksum { stored, computed } => {
                write!(
                    out,
                    "checksum {computed:08x} differs from the stored {stored:08x}: the bytes changed"
                )
            }
            Self::BadField { field, value } => {
                write!(out, "manifest field {field} is unusable ({value})")
            }
            Self::OverLimit { field, value, max } => {
                write!(out, "{field} is {value}, at most {max} fit")
            }
            Self::AccumulatorOverflow { layer, row } => {
                write!(out, "row {row} of layer {layer} could overflow its accumulator")
            }
            Self::FormatNotBuilt(format) => {
                write!(out, "number format {} is not part of this build", format.name())
            }
            Self::NoPairKernel(format) => {
                write!(out, "no kernel decodes two frames of this {} model at once", format.name())
            }
            Self::PackedForAnotherKernel { packing, family } => {
                write!(
                    out,
                    "weights are packed as {}, which the {family} kernels of this build do not read",
                    packing.name()
                )
            }
            Self::Misaligned { misalignment, alignment } => {
                write!(
                    out,
                    "the blob starts {misalignment} bytes past a multiple of {alignment}: align it"
                )
            }
            Self::BadServo { servo, error } => write!(out, "servo {servo}: {error}"),
            Self::WorkspaceTooSmall { width, needed } => {
                write!(out, "the workspace is {width} wide, the model needs {needed}")
            }
        }
    }
}

impl core::error::Error for BlobError {}

/// Why no code could be sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SampleError {
    /// The model has fewer actions. Look names up with `Model::action_by_name`.
    UnknownAction {
        /// Index asked for.
        action: u16,
        /// Number of actions of the model.
        count: u16,
    },
    /// No clip of this action was that long or short. Clamp to `Model::trained_frames` if that is what you want.
    OutsideTraining {
        /// Frames asked for.
        frames: u32,
        /// Shortest trained motion.
        frames_min: u32,
        /// Longest trained motion.
        frames_max: u32,
    },
}

impl fmt::Display for SampleError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::UnknownAction { action, count } => {
                write!(out, "action {action} does not exist, the model has {count}")
            }
            Self::OutsideTraining { frames, frames_min, frames_max } => {
                write!(out, "{frames} frames are outside the trained {frames_min} to {frames_max}")
            }
        }
    }
}

impl core::error::Error for SampleError {}

/// Why a body does not do what it was told; it goes on as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlayError {
    /// The model has more channels than this voice or player was built for. Raise its `CHANNELS`.
    TooManyChannels {
        /// Channels of the model.
        count: usize,
        /// Channels that fit.
        max: usize,
    },
    /// As many motions wait as fit. Ask again when one has ended, or play one at once.
    QueueFull {
        /// Motions that fit.
        max: usize,
    },
    /// An overlay of more channels than [`OVERLAY_CHANNELS_MAX`](crate::limits::OVERLAY_CHANNELS_MAX), or more
    /// overlays than [`OVERLAYS_MAX`](crate::limits::OVERLAYS_MAX). Use fewer.
    TooManyOverlays {
        /// Channels or overlays asked for.
        count: usize,
        /// As many fit.
        max: usize,
    },
    /// The motion cannot be drawn.
    Sample(SampleError),
}

impl fmt::Display for PlayError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooManyChannels { count, max } => {
                write!(out, "the model has {count} channels, at most {max} fit")
            }
            Self::TooManyOverlays { count, max } => {
                write!(out, "{count} overlays or channels of one, at most {max} fit")
            }
            Self::QueueFull { max } => write!(out, "{max} motions wait already, no more fit"),
            Self::Sample(error) => error.fmt(out),
        }
    }
}

impl core::error::Error for PlayError {}

impl From<SampleError> for PlayError {
    fn from(error: SampleError) -> Self {
        Self::Sample(error)
    }
}

/// Why servos cannot be driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ServoError {
    /// The neutral pulse is not between the shortest and the longest. Measure the three again.
    PulsesOutOfOrder {
        /// Channel that drives the servo.
        channel: u16,
        /// Shortest, neutral and longest pulse as given.
        pulses_us: [u16; 3],
    },
    /// A speed limit of 0: the servo could never move. Give its real speed, or leave the servo out.
    NoSpeed {
        /// Channel that drives the servo.
        channel: u16,
    },
    /// A pulse of 0 means no pulse, and none is longer than 20,000 µs. Give the pulses in microseconds.
    PulseImpossible {
        /// Channel that drives the servo.
        channel: u16,
        /// Shortest, neutral and longest pulse as given.
        pulses_us: [u16; 3],
    },
    /// The shortest pulse is also the longest: the servo could never move. Measure both ends, or leave the servo out.
    NoSpan {
        /// Channel that drives the servo.
        channel: u16,
        /// The only pulse.
        pulse_us: u16,
    },
    /// The park pulse is beyond the range. Park the servo within it, or measure the range again.
    ParkOutside {
        /// Channel that drives the servo.
        channel: u16,
        /// Park pulse as given.
        pulse_us: u16,
        /// Shortest and longest pulse.
        range_us: [u16; 2],
    },
    /// The trim moves the neutral pulse out of the range. Mount the horn closer to its middle.
    TrimOutside {
        /// Channel that drives the servo.
        channel: u16,
        /// Trim as given.
        trim_us: i16,
        /// Shortest and longest pulse.
        range_us: [u16; 2],
    },
    /// An acceleration limit of 0: the servo could never start. Ten times the speed is a usual value.
    NoAcceleration {
        /// Channel that drives the servo.
        channel: u16,
    },
    /// From full speed the servo could not stop within its range. Allow more acceleration or less speed.
    CannotBrake {
        /// Channel that drives the servo.
        channel: u16,
        /// Speed and acceleration as given.
        limits: ServoLimits,
        /// Way from the shortest to the longest pulse.
        span_us: u16,
    },
    /// More servos than [`SERVOS_MAX`](crate::limits::SERVOS_MAX).
    TooMany {
        /// The first servo that does not fit, counted from 1.
        count: usize,
        /// Servos that fit.
        max: usize,
    },
}

impl fmt::Display for ServoError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::PulsesOutOfOrder { channel, pulses_us: [min, neutral, max] } => {
                write!(
                    out,
                    "the servo of channel {channel} has pulses of {min}, {neutral} and {max} us, \
                     expected shortest, neutral, longest"
                )
            }
            Self::NoSpeed { channel } => {
                write!(out, "the servo of channel {channel} has a speed limit of 0")
            }
            Self::PulseImpossible { channel, pulses_us: [min, neutral, max] } => {
                write!(
                    out,
                    "the servo of channel {channel} has pulses of {min}, {neutral} and {max} us, \
                     expected 1 to 20000"
                )
            }
            Self::NoSpan { channel, pulse_us } => {
                write!(
                    out,
                    "the servo of channel {channel} has no span: its shortest and its longest \
                     pulse are both {pulse_us} us"
                )
            }
            Self::ParkOutside { channel, pulse_us, range_us: [min, max] } => {
                write!(
                    out,
                    "the servo of channel {channel} is parked at {pulse_us} us, outside its range \
                     of {min} to {max} us"
                )
            }
            Self::TrimOutside { channel, trim_us, range_us: [min, max] } => {
                write!(
                    out,
                    "the servo of channel {channel} is trimmed by {trim_us} us, which moves neutral \
                     outside its range of {min} to {max} us"
                )
            }
            Self::NoAcceleration { channel } => {
                write!(out, "the servo of channel {channel} has an acceleration limit of 0")
            }
            Self::CannotBrake { channel, limits, span_us } => {
                let braking_us = limits.braking_us();
                write!(
                    out,
                    "the servo of channel {channel} needs {braking_us} us to stop from full speed, \
                     its range is {span_us} us"
                )
            }
            Self::TooMany { count, max } => {
                write!(out, "servo number {count} does not fit, at most {max} do")
            }
        }
    }
}

impl core::error::Error for ServoError {}
