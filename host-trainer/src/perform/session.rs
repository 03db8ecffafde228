//! The host's end of the link: a command counts when the body says so, and is sent again until it does.
//!
//! In:  commands, blobs; bytes of a port that waits only shortly.
//! Out: what the body answers, and everything else that it reports.

mod load;

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use karakuri::link::{
    CHUNK_HEAD_BYTES_MAX, COMMAND_BYTES_MAX, Command, LinkError, REPORT_BYTES_MAX, Receiver,
    Refusal, Report, frame_bytes_max, receiver_bytes,
};

use crate::error::{Error, Result};

/// How often a command is sent before the body counts as silent.
const ATTEMPTS: u32 = 4;

/// How long one answer may take.
const ANSWER_TIME: Duration = Duration::from_millis(400);

/// How long an answer may still take after the body heard something broken: that may have been noise before the frame.
const AFTER_NOISE: Duration = Duration::from_millis(50);

/// A body that has answered.
pub struct Session<Port> {
    port: Port,
    name: PathBuf,
    receiver: Receiver<{ receiver_bytes(REPORT_BYTES_MAX) }>,
    sequence: u16,
    reports: VecDeque<Report>,
    resent: u32,
}

impl<Port: Read + Write> Session<Port> {
    /// Says hello; `port` is called `name` in errors and waits at most a few milliseconds for a byte.
    ///
    /// # Errors
    /// See [`command`](Self::command).
    pub fn open(port: Port, name: &Path) -> Result<Self> {
        let (receiver, reports) = (Receiver::new(), VecDeque::new());
        let name = name.to_owned();
        let mut session = Self { port, name, receiver, sequence: 0, reports, resent: 0 };
        session.command(&Command::Hello)?.map_err(|reason| session.refused(reason))?;
        Ok(session)
    }

    /// Gives a command; the inner result is the body's answer.
    ///
    /// # Errors
    /// [`Error::Io`] where the port fails, [`Error::BadInput`] where nobody answers or the body speaks a newer
    /// protocol.
    pub fn command(&mut self, command: &Command<'_>) -> Result<std::result::Result<(), Refusal>> {
        self.command_within(command, ANSWER_TIME)
    }

    /// [`command`](Self::command) with another time for each answer.
    fn command_within(
        &mut self,
        command: &Command<'_>,
        answer_time: Duration,
    ) -> Result<std::result::Result<(), Refusal>> {
        self.sequence = self.sequence.wrapping_add(1);
        let message_bytes = match command {
            Command::LoadChunk { bytes, .. } => CHUNK_HEAD_BYTES_MAX + bytes.len(),
            _ => COMMAND_BYTES_MAX,
        };
        let mut buffer = vec![0; frame_bytes_max(message_bytes)];
        let frame = command.encode(self.sequence, &mut buffer);
        let frame = frame.map_err(|error| self.broken(error))?;
        for attempt in 0..ATTEMPTS {
            self.resent += u32::from(attempt > 0);
            let written = self.port.write_all(frame).and_then(|()| self.port.flush());
            written.map_err(Error::io("write to", &self.name))?;
            if let Some(answer) = self.answer(answer_time)? {
                return Ok(answer);
            }
        }
        let field = match command {
            Command::LoadChunk { offset, .. } => format!("answer to LoadChunk at byte {offset}"),
            command => format!("answer to {command:?}"),
        };
        let value = format!("none to {ATTEMPTS} frames");
        let remedy = "check cable and --baud, and that the firmware uses karakuri::link";
        Err(Error::bad_input(&self.name, field, value, "an acknowledgement", remedy))
    }

    /// Waits for reports until then.
    ///
    /// # Errors
    /// [`Error::Io`] where the port fails.
    pub fn listen(&mut self, until: Instant) -> Result<()> {
        while Instant::now() < until && self.reports.is_empty() {
            if let Some(report) = self.receive()? {
                self.reports.push_back(report);
            }
        }
        Ok(())
    }

    /// The oldest report that was no answer.
    pub fn take_report(&mut self) -> Option<Report> {
        self.reports.pop_front()
    }

    /// Frames that had to be sent again.
    pub fn resent(&self) -> u32 {
        self.resent
    }

    /// The error of a refused command.
    pub fn refused(&self, reason: Refusal) -> Error {
        let remedy = "see `host-trainer perform --help`, and what the body has reported";
        Error::bad_input(&self.name, "answer", format!("{reason:?}"), "obedience", remedy)
    }

    /// The answer to the last frame; `None` where it has to be sent again.
    fn answer(
        &mut self,
        answer_time: Duration,
    ) -> Result<Option<std::result::Result<(), Refusal>>> {
        let mut until = Instant::now() + answer_time;
        while Instant::now() < until {
            match self.receive()? {
                Some(Report::Ack { sequence }) if sequence == self.sequence => {
                    return Ok(Some(Ok(())));
                }
                Some(Report::Refused { sequence, reason }) if sequence == self.sequence => {
                    return Ok(Some(Err(reason)));
                }
                // Answers to what was sent twice.
                Some(Report::Ack { .. } | Report::Refused { .. }) | None => {}
                Some(Report::Broken { .. }) => until = until.min(Instant::now() + AFTER_NOISE),
                Some(report) => self.reports.push_back(report),
            }
        }
        Ok(None)
    }

    /// The next report, or nothing for as long as the port waits.
    fn receive(&mut self) -> Result<Option<Report>> {
        let mut byte = [0];
        loop {
            match self.port.read(&mut byte) {
                Ok(0) => return Ok(None),
                Ok(_) => {}
                Err(error) if is_silence(error.kind()) => return Ok(None),
                Err(error) => return Err(Error::io("read from", &self.name)(error)),
            }
            let Some(frame) = self.receiver.push(byte[0]) else { continue };
            match frame.and_then(|frame| frame.report()) {
                Ok(report) => return Ok(Some(report)),
                Err(error @ LinkError::NewerVersion { .. }) => return Err(self.broken(error)),
                // A damaged answer is asked for again.
                Err(_) => {}
            }
        }
    }

    fn broken(&self, error: LinkError) -> Error {
        let remedy = "use the host-trainer that the firmware was built with";
        Error::bad_input(&self.name, "frame", error, "protocol version 1", remedy)
    }
}

fn is_silence(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use karakuri::link::{Arrival, Inbox};

    /// A body that knows nothing but its inbox, at a bad line: every `damage`th frame either way loses a bit.
    struct BadLine {
        inbox: Inbox<64>,
        to_host: VecDeque<u8>,
        obeyed: Vec<u16>,
        damage: u32,
        frames: u32,
    }

    impl BadLine {
        fn new(damage: u32) -> Self {
            let (inbox, to_host) = (Inbox::new(), VecDeque::new());
            Self { inbox, to_host, obeyed: Vec::new(), damage, frames: 0 }
        }

        fn through(&mut self, frame: &[u8]) -> Vec<u8> {
            self.frames += 1;
            let mut bytes = frame.to_vec();
            if self.damage > 0 && self.frames.is_multiple_of(self.damage) {
                bytes[4] ^= 0x10;
            }
            bytes
        }
    }

    impl Read for &mut BadLine {
        fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
            bytes[0] = self.to_host.pop_front().ok_or(ErrorKind::TimedOut)?;
            Ok(1)
        }
    }

    impl Write for &mut BadLine {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            for byte in self.through(bytes) {
                let report = match self.inbox.push(byte) {
                    None => continue,
                    Some(Arrival::Answer(report)) => report,
                    Some(Arrival::Act { sequence, command }) => {
                        let outcome = match command {
                            Command::Wake => Err(Refusal::NotSupported),
                            _ => Ok(()),
                        };
                        self.obeyed.push(sequence);
                        self.inbox.answer(sequence, outcome)
                    }
                };
                let mut buffer = [0; 64];
                let frame = report.encode(0, &mut buffer).unwrap().to_vec();
                let frame = self.through(&frame);
                self.to_host.extend(frame);
            }
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn body_that_never_answers_is_named() {
        let mut line = BadLine::new(1);
        let error = Session::open(&mut line, Path::new("/dev/ttyX")).err().unwrap();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("/dev/ttyX") && error.to_string().contains("--baud"));
        assert!(line.obeyed.is_empty());
    }

    #[test]
    fn refusal_is_the_bodys_own() {
        let mut line = BadLine::new(0);
        let mut session = Session::open(&mut line, Path::new("port")).unwrap();
        assert_eq!(session.command(&Command::Wake).unwrap(), Err(Refusal::NotSupported));
        assert_eq!(session.resent(), 0);
    }

    #[test]
    fn every_command_is_obeyed_once_over_a_bad_line() {
        let mut line = BadLine::new(3);
        let mut session = Session::open(&mut line, Path::new("port")).unwrap();
        for _ in 0..5 {
            session.command(&Command::ClearFault).unwrap().unwrap();
        }
        assert!(session.resent() > 0);
        line.obeyed.dedup();
        assert_eq!(line.obeyed, [1, 2, 3, 4, 5, 6]);
    }
}
