//! A blob that comes in pieces over the link → flash.
//!
//! In:  the three load commands, in their order.
//! Out: bytes to a [`BlobSink`], each once.
//!
//! Why here: flash differs from chip to chip, what must be checked does not.

use super::{Command, Refusal};
use crate::crc32::{Crc32, crc32};

/// Where a chip keeps its blob.
///
/// Beside [`Performer::hear_or_load`](super::Performer::hear_or_load) the old blob stays whole until the commit: it is
/// played again if the new one is refused. Where there is room for one only, the player has to go before
/// [`begin`](Self::begin) erases it; such a program hands the commands to its [`Loader`] itself.
pub trait BlobSink {
    /// Makes room for `len_bytes`.
    ///
    /// # Errors
    /// [`SinkError::TooLarge`], [`SinkError::Failed`].
    fn begin(&mut self, len_bytes: u32) -> Result<(), SinkError>;

    /// Writes the next bytes, `offset` bytes from the blob's start. Pieces come without gaps; their lengths are the
    /// sender's choice, so a chip with pages gathers them.
    ///
    /// # Errors
    /// [`SinkError::Failed`].
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), SinkError>;

    /// All bytes came, and their checksum fits. What was written must now be read back with `Model::load`, which
    /// checks it as it lies in flash.
    ///
    /// # Errors
    /// [`SinkError::Rejected`] where it does not load, [`SinkError::Failed`].
    fn commit(&mut self, len_bytes: u32) -> Result<(), SinkError>;
}

/// What can go wrong where a blob is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SinkError {
    /// There is not so much room.
    TooLarge,
    /// The flash could not be erased or written.
    Failed,
    /// The blob cannot be used by this firmware.
    Rejected,
}

impl From<SinkError> for Refusal {
    fn from(error: SinkError) -> Self {
        match error {
            SinkError::TooLarge => Self::BlobTooLarge,
            SinkError::Failed => Self::FlashFailed,
            SinkError::Rejected => Self::BadBlob,
        }
    }
}

/// The CRC-32 of a blob's file, as [`Command::LoadBegin`] announces it.
pub fn blob_crc(blob: &[u8]) -> u32 {
    crc32([blob])
}

/// How far a blob has come.
#[derive(Clone, Debug, Default)]
pub struct Loader {
    under_way: Option<UnderWay>,
}

#[derive(Clone, Debug)]
struct UnderWay {
    len_bytes: u32,
    crc_announced: u32,
    received_bytes: u32,
    crc: Crc32,
}

impl Loader {
    /// Nothing under way.
    pub const fn new() -> Self {
        Self { under_way: None }
    }

    /// Obeys a load command. After any refusal but [`Refusal::WrongOffset`] the blob has to be sent from its
    /// [`Command::LoadBegin`] on.
    ///
    /// # Errors
    /// [`Refusal::NotBegun`], [`Refusal::WrongOffset`], [`Refusal::WrongChecksum`], what the sink refuses, and
    /// [`Refusal::NotSupported`] for every other command.
    pub fn obey(&mut self, command: &Command<'_>, sink: &mut impl BlobSink) -> Result<(), Refusal> {
        match *command {
            Command::LoadBegin { len_bytes, crc } => {
                self.under_way = None;
                sink.begin(len_bytes)?;
                let crc_announced = crc;
                let crc = Crc32::new();
                self.under_way =
                    Some(UnderWay { len_bytes, crc_announced, received_bytes: 0, crc });
                Ok(())
            }
            Command::LoadChunk { offset, bytes } => self.take(offset, bytes, sink),
            Command::LoadCommit => self.commit(sink),
            _ => Err(Refusal::NotSupported),
        }
    }

    fn take(&mut self, offset: u32, bytes: &[u8], sink: &mut impl BlobSink) -> Result<(), Refusal> {
        let under_way = self.under_way.as_mut().ok_or(Refusal::NotBegun)?;
        let expected = under_way.received_bytes;
        let room = under_way.len_bytes - expected;
        let fits = u32::try_from(bytes.len()).ok().filter(|&len| len <= room);
        let Some(len) = fits.filter(|_| offset == expected) else {
            return Err(Refusal::WrongOffset { expected });
        };
        if let Err(error) = sink.write(offset, bytes) {
            self.under_way = None;
            return Err(error.into());
        }
        bytes.iter().for_each(|&byte| under_way.crc.update(byte));
        under_way.received_bytes += len;
        Ok(())
    }

    fn commit(&mut self, sink: &mut impl BlobSink) -> Result<(), Refusal> {
        let under_way = self.under_way.as_ref().ok_or(Refusal::NotBegun)?;
        if under_way.received_bytes < under_way.len_bytes {
            return Err(Refusal::WrongOffset { expected: under_way.received_bytes });
        }
        let (len_bytes, fits) =
            (under_way.len_bytes, under_way.crc.value() == under_way.crc_announced);
        self.under_way = None;
        if !fits {
            return Err(Refusal::WrongChecksum);
        }
        Ok(sink.commit(len_bytes)?)
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// Flash of 100 bytes.
    #[derive(Default)]
    struct Flash {
        bytes: Vec<u8>,
        is_worn: bool,
        committed: Option<u32>,
    }

    impl BlobSink for Flash {
        fn begin(&mut self, len_bytes: u32) -> Result<(), SinkError> {
            self.bytes.clear();
            if len_bytes > 100 { Err(SinkError::TooLarge) } else { Ok(()) }
        }

        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), SinkError> {
            assert_eq!(offset as usize, self.bytes.len(), "no gap");
            self.bytes.extend(bytes);
            if self.is_worn { Err(SinkError::Failed) } else { Ok(()) }
        }

        fn commit(&mut self, len_bytes: u32) -> Result<(), SinkError> {
            self.committed = Some(len_bytes);
            Ok(())
        }
    }

    const BLOB: [u8; 100] = [0x5A; 100];

    fn begun(crc: u32) -> (Loader, Flash) {
        let (mut loader, mut flash) = (Loader::new(), Flash::default());
        loader.obey(&Command::LoadBegin { len_bytes: 100, crc }, &mut flash).unwrap();
        (loader, flash)
    }

    fn chunk(offset: u32, bytes: &[u8]) -> Command<'_> {
        Command::LoadChunk { offset, bytes }
    }

    #[test]
    fn blob_that_does_not_fit_is_refused_before_anything_is_sent() {
        let (mut loader, mut flash) = (Loader::new(), Flash::default());
        let begin = Command::LoadBegin { len_bytes: 101, crc: 0 };
        assert_eq!(loader.obey(&begin, &mut flash), Err(Refusal::BlobTooLarge));
        assert_eq!(loader.obey(&chunk(0, &[1]), &mut flash), Err(Refusal::NotBegun));
        assert_eq!(loader.obey(&Command::LoadCommit, &mut flash), Err(Refusal::NotBegun));
    }

    #[test]
    fn piece_that_leaves_a_gap_comes_twice_or_is_too_long_is_refused() {
        let (mut loader, mut flash) = begun(0);
        loader.obey(&chunk(0, &BLOB[..60]), &mut flash).unwrap();
        let refusal = Err(Refusal::WrongOffset { expected: 60 });
        for wrong in [chunk(61, &BLOB[..5]), chunk(0, &BLOB[..60]), chunk(60, &BLOB[..41])] {
            assert_eq!(loader.obey(&wrong, &mut flash), refusal);
        }
        assert_eq!(loader.obey(&Command::LoadCommit, &mut flash), refusal);
        assert_eq!(flash.bytes.len(), 60);
    }

    #[test]
    fn changed_blob_is_never_committed() {
        let (mut loader, mut flash) = begun(crc32([BLOB.as_slice()]) ^ 1);
        loader.obey(&chunk(0, &BLOB), &mut flash).unwrap();
        assert_eq!(loader.obey(&Command::LoadCommit, &mut flash), Err(Refusal::WrongChecksum));
        assert_eq!(flash.committed, None);
        assert_eq!(loader.obey(&Command::LoadCommit, &mut flash), Err(Refusal::NotBegun));
    }

    #[test]
    fn worn_flash_ends_the_load() {
        let (mut loader, mut flash) = begun(0);
        flash.is_worn = true;
        assert_eq!(loader.obey(&chunk(0, &BLOB), &mut flash), Err(Refusal::FlashFailed));
        assert_eq!(loader.obey(&chunk(0, &BLOB), &mut flash), Err(Refusal::NotBegun));
    }

    #[test]
    fn blob_arrives_in_pieces_of_any_length() {
        let (mut loader, mut flash) = begun(crc32([BLOB.as_slice()]));
        for (offset, end) in [(0, 1), (1, 64), (64, 64), (64, 100)] {
            loader.obey(&chunk(offset as u32, &BLOB[offset..end]), &mut flash).unwrap();
        }
        loader.obey(&Command::LoadCommit, &mut flash).unwrap();
        assert_eq!((flash.bytes.as_slice(), flash.committed), (BLOB.as_slice(), Some(100)));
    }
}
