//! Where a served body keeps a blob that comes over the line: memory, where firmware has a second half of its flash.
//!
//! In:  bytes in pieces, from `karakuri::link`.
//! Out: a blob that a body can be made of.
//!
//! Why here: the blob that is played stays whole until the new one has proven itself.

use karakuri::Model;
use karakuri::link::{BlobSink, SinkError};

use crate::error;
use crate::host::widest_workspace;
use crate::serve::player;
use crate::trace::Options;

/// Bytes of the largest blob; the largest preset's needs a tenth.
const BYTES_MAX: u32 = 16 << 20;

/// A place for one blob.
pub struct Shelf {
    options: Options,
    arriving: Vec<u8>,
    committed: Option<Vec<u8>>,
}

impl Shelf {
    /// An empty one; `options`: how a body is made of what comes.
    pub fn new(options: &Options) -> Self {
        Self { options: options.clone(), arriving: Vec::new(), committed: None }
    }

    /// The blob that came whole and was found good.
    pub fn take(&mut self) -> Option<Vec<u8>> {
        self.committed.take()
    }
}

impl BlobSink for Shelf {
    fn begin(&mut self, len_bytes: u32) -> Result<(), SinkError> {
        self.arriving.clear();
        if len_bytes > BYTES_MAX { Err(SinkError::TooLarge) } else { Ok(()) }
    }

    fn write(&mut self, _offset: u32, bytes: &[u8]) -> Result<(), SinkError> {
        self.arriving.extend(bytes);
        Ok(())
    }

    fn commit(&mut self, _len_bytes: u32) -> Result<(), SinkError> {
        let blob = std::mem::take(&mut self.arriving);
        check(&blob, &self.options).map_err(|_| SinkError::Rejected)?;
        self.committed = Some(blob);
        Ok(())
    }
}

/// Whether a body can be made of a blob.
fn check(blob: &[u8], options: &Options) -> error::Result<()> {
    let model = Model::from_bytes(blob)?;
    player(&model, &mut widest_workspace(), options).map(|_| ())
}
