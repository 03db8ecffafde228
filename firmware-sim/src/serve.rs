//! A body at a line, in real time: what firmware does with `karakuri::link`, on this computer.
//!
//! In:  a model; bytes that a host sends.
//! Out: bytes that the host reads; another blob, if the host sent one.
//!
//! Why here: the protocol is tested end to end with the very performer that firmware runs, before there is a board.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use karakuri::link::{
    CHUNK_HEAD_BYTES_MAX, Loader, Performer, REPORT_BYTES_MAX, Report, frame_bytes_max,
    receiver_bytes,
};
use karakuri::{Decoder, Model, Player, ServoStage, Workspace};

use crate::error::{Error, Result};
use crate::shelf::Shelf;
use crate::trace::{Options, own_servos, stand_ins};

/// As many as a model may have.
const CHANNELS: usize = karakuri::limits::CHANNELS_MAX;
const WIDTH: usize = karakuri::limits::WIDTH_MAX;

/// Ticks between two reports of telemetry.
const TELEMETRY_TICKS: u32 = 5;

/// Time that one tick passes at most.
const LONGEST_TICK: Duration = Duration::from_millis(100);

/// Bytes of a blob in one command: a page of most flash chips.
const CHUNK_BYTES: usize = 256;

/// The body's end of the line, which outlives the blobs that are played.
pub struct LineEnd<Line> {
    performer: Performer<{ receiver_bytes(CHUNK_HEAD_BYTES_MAX + CHUNK_BYTES) }>,
    loader: Loader,
    shelf: Shelf,
    line: Line,
    sequence: u16,
}

impl<Line: Write> LineEnd<Line> {
    /// An end at which nobody has spoken; bodies are made as `options` say.
    pub fn new(line: Line, options: &Options) -> Self {
        let (performer, loader, shelf) = (Performer::new(), Loader::new(), Shelf::new(options));
        Self { performer, loader, shelf, line, sequence: 0 }
    }

    fn send_reports(&mut self) -> io::Result<()> {
        while let Some(report) = self.performer.take_report() {
            self.send(&report)?;
        }
        Ok(())
    }

    fn send(&mut self, report: &Report) -> io::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; frame_bytes_max(REPORT_BYTES_MAX)];
        let frame = report.encode(self.sequence, &mut buffer).map_err(io::Error::other)?;
        self.line.write_all(frame)
    }
}

/// A player with the servos of the blob, or else those of [`trace`](crate::trace::trace), released.
///
/// # Errors
/// A model without scalar channels, or with too many.
pub fn player<'m, 'w>(
    model: &'m Model<'m>,
    workspace: &'w mut Workspace<WIDTH>,
    options: &Options,
) -> Result<Player<'m, 'w, CHANNELS>> {
    let (_, maps) = match own_servos(model) {
        Some(own) => own,
        None => stand_ins(model.groups(), options)?,
    };
    let refused = |reason: &dyn ToString| {
        let remedy = "serve a model of servo tracks (`host-trainer demo` makes one)";
        Error::bad_input("model", "servos", reason.to_string(), "servos for core", remedy)
    };
    let stage = ServoStage::new(&maps).map_err(|error| refused(&error))?;
    let decoder = Decoder::new(model, workspace)?;
    Player::new(model, decoder, 1, stage, options.seed).map_err(|error| refused(&error))
}

/// A body, and the line it is at.
pub struct Served<'m, 'w, 'l, Line> {
    player: Player<'m, 'w, CHANNELS>,
    end: &'l mut LineEnd<Line>,
    ticks: u32,
}

impl<'m, 'w, 'l, Line: Write> Served<'m, 'w, 'l, Line> {
    /// A freshly booted body.
    pub fn new(player: Player<'m, 'w, CHANNELS>, end: &'l mut LineEnd<Line>) -> Self {
        Self { player, end, ticks: 0 }
    }

    /// Hears bytes of the host and answers. A blob that was committed ends it: what came behind is not heard, as by
    /// a chip that resets.
    ///
    /// # Errors
    /// What the line says.
    pub fn hear(&mut self, bytes: &[u8]) -> io::Result<Option<Vec<u8>>> {
        for &byte in bytes {
            let LineEnd { performer, loader, shelf, .. } = &mut *self.end;
            let is_committed = performer.hear_or_load(byte, &mut self.player, loader, shelf);
            self.end.send_reports()?;
            if is_committed {
                return Ok(self.end.shelf.take());
            }
        }
        Ok(None)
    }

    /// Lets time pass.
    ///
    /// # Errors
    /// What the line says.
    pub fn tick(&mut self, elapsed_us: u32) -> io::Result<()> {
        self.player.tick(elapsed_us);
        self.end.performer.ticked(&self.player);
        self.end.send_reports()?;
        self.ticks = self.ticks.wrapping_add(1);
        if self.ticks.is_multiple_of(TELEMETRY_TICKS) {
            let telemetry = self.end.performer.telemetry(&self.player);
            self.end.send(&telemetry)?;
        }
        Ok(())
    }

    /// Ticks at a rate and hears in between, until the time is over, nobody can send any more, or a new blob came,
    /// which is returned. Where this computer is too busy, the body's time stands: a desk is no real-time system, and
    /// that is no fault of the body.
    ///
    /// # Errors
    /// What the line says.
    pub fn serve(
        &mut self,
        heard: &Receiver<Vec<u8>>,
        tick: Duration,
        until: Instant,
    ) -> io::Result<Option<Vec<u8>>> {
        let mut last = Instant::now();
        while Instant::now() < until {
            loop {
                match heard.try_recv() {
                    Ok(bytes) => {
                        if let Some(blob) = self.hear(&bytes)? {
                            return Ok(Some(blob));
                        }
                    }
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return Ok(None),
                }
            }
            let elapsed = last.elapsed();
            if elapsed < tick {
                thread::sleep((tick - elapsed).min(Duration::from_millis(2)));
                continue;
            }
            last += elapsed;
            self.tick(elapsed.min(LONGEST_TICK).as_micros() as u32)?;
        }
        Ok(None)
    }
}
