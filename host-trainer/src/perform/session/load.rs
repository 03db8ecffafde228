//! A blob → the body: in pieces, each acknowledged before the next is sent.
//!
//! In:  the bytes of a blob's file; a session.
//! Out: a body that plays from it, or the reason why it does not.

use std::io::{Read, Write};
use std::time::{Duration, Instant};

use karakuri::link::{Command, Refusal, Report, blob_crc};

use super::{ANSWER_TIME, ATTEMPTS, Session};
use crate::error::{Error, Result};

/// Longest piece, bytes: a page of most flash chips, and little to send again.
const CHUNK_BYTES_MAX: usize = 256;

/// How long one answer may take where the body erases flash, or reads a whole blob back.
const FLASH_TIME: Duration = Duration::from_secs(4);

impl<Port: Read + Write> Session<Port> {
    /// Sends a blob and begins a new session with the body that plays from it; `sent` is told of the bytes that have
    /// arrived. The inner result is the body's answer, after a refusal it plays from the blob of before.
    ///
    /// # Errors
    /// See [`command`](Self::command).
    pub fn load(
        &mut self,
        blob: &[u8],
        sent: impl FnMut(usize),
    ) -> Result<std::result::Result<(), Refusal>> {
        let chunk_bytes = usize::from(self.chunk_bytes_max()?).min(CHUNK_BYTES_MAX);
        if chunk_bytes == 0 {
            return Ok(Err(Refusal::NotSupported));
        }
        if let Err(reason) = self.send_blob(blob, chunk_bytes, sent)? {
            return Ok(Err(reason));
        }
        self.reports.retain(|report| !matches!(report, Report::Hello { .. }));
        self.command(&Command::Hello)
    }

    fn send_blob(
        &mut self,
        blob: &[u8],
        chunk_bytes: usize,
        mut sent: impl FnMut(usize),
    ) -> Result<std::result::Result<(), Refusal>> {
        let Ok(len_bytes) = u32::try_from(blob.len()) else {
            return Ok(Err(Refusal::BlobTooLarge));
        };
        let crc = blob_crc(blob);
        let mut answer = self.command_within(&Command::LoadBegin { len_bytes, crc }, FLASH_TIME)?;
        let mut offset = 0;
        for bytes in blob.chunks(chunk_bytes) {
            if answer.is_err() {
                return Ok(answer);
            }
            answer = self.command(&Command::LoadChunk { offset, bytes })?;
            offset += bytes.len() as u32;
            sent(offset as usize);
        }
        match answer {
            Ok(()) => self.command_within(&Command::LoadCommit, FLASH_TIME),
            refused => Ok(refused),
        }
    }

    /// What the body said about chunks when it was greeted; greets it again if that got lost.
    fn chunk_bytes_max(&mut self) -> Result<u16> {
        for _ in 0..ATTEMPTS {
            let until = Instant::now() + ANSWER_TIME;
            while Instant::now() < until {
                let said = self.reports.iter().rev().find_map(|report| match report {
                    Report::Hello { chunk_bytes_max, .. } => Some(*chunk_bytes_max),
                    _ => None,
                });
                if let Some(chunk_bytes_max) = said {
                    return Ok(chunk_bytes_max);
                }
                let report = self.receive()?;
                self.reports.extend(report);
            }
            self.command(&Command::Hello)?.map_err(|reason| self.refused(reason))?;
        }
        let remedy = "check cable and --baud";
        let (field, value) = ("answer to Hello", "an acknowledgement only");
        Err(Error::bad_input(&self.name, field, value, "what the body can do", remedy))
    }
}
