//! A body at a line, in real time: what firmware does with `karakuri::link`, on this computer.
//!
//! In:  a model; bytes that a host sends.
//! Out: bytes that the host reads.
//!
//! Why here: the protocol is tested end to end with the very performer that firmware runs, before there is a board.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use karakuri::link::{
    COMMAND_BYTES_MAX, Performer, REPORT_BYTES_MAX, Report, frame_bytes_max, receiver_bytes,
};
use karakuri::{Decoder, Model, Player, ServoStage, Workspace};

use crate::error::{Error, Result};
use crate::trace::{Options, own_servos, stand_ins};

/// As many as a model may have.
const CHANNELS: usize = karakuri::limits::CHANNELS_MAX;
const WIDTH: usize = karakuri::limits::WIDTH_MAX;

/// Ticks between two reports of telemetry.
const TELEMETRY_TICKS: u32 = 5;

/// Time that one tick passes at most.
const LONGEST_TICK: Duration = Duration::from_millis(100);

/// A body and its line.
pub struct Served<'m, 'w, Line> {
    player: Player<'m, 'w, CHANNELS>,
    performer: Performer<{ receiver_bytes(COMMAND_BYTES_MAX) }>,
    line: Line,
    sequence: u16,
    ticks: u32,
}

impl<'m, 'w, Line: Write> Served<'m, 'w, Line> {
    /// A body with the servos of the blob, or else those of [`trace`](crate::trace::trace), released.
    ///
    /// # Errors
    /// A model without scalar channels, or with too many.
    pub fn new(
        model: &'m Model<'m>,
        workspace: &'w mut Workspace<WIDTH>,
        options: &Options,
        line: Line,
    ) -> Result<Self> {
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
        let player = Player::new(model, decoder, 1, stage, options.seed);
        let player = player.map_err(|error| refused(&error))?;
        Ok(Self { player, performer: Performer::new(), line, sequence: 0, ticks: 0 })
    }

    /// Hears bytes of the host and answers.
    ///
    /// # Errors
    /// What the line says.
    pub fn hear(&mut self, bytes: &[u8]) -> io::Result<()> {
        for &byte in bytes {
            self.performer.hear(byte, &mut self.player);
            self.send_reports()?;
        }
        Ok(())
    }

    /// Lets time pass.
    ///
    /// # Errors
    /// What the line says.
    pub fn tick(&mut self, elapsed_us: u32) -> io::Result<()> {
        self.player.tick(elapsed_us);
        self.performer.ticked(&self.player);
        self.send_reports()?;
        self.ticks = self.ticks.wrapping_add(1);
        if self.ticks.is_multiple_of(TELEMETRY_TICKS) {
            let telemetry = self.performer.telemetry(&self.player);
            self.send(&telemetry)?;
        }
        Ok(())
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

    /// Ticks at a rate and hears in between, until the time is over or nobody can send any more. Where this computer
    /// is too busy, the body's time stands: a desk is no real-time system, and that is no fault of the body.
    ///
    /// # Errors
    /// What the line says.
    pub fn serve(
        &mut self,
        heard: &Receiver<Vec<u8>>,
        tick: Duration,
        time: Duration,
    ) -> io::Result<()> {
        let (start, mut last) = (Instant::now(), Instant::now());
        while start.elapsed() < time {
            loop {
                match heard.try_recv() {
                    Ok(bytes) => self.hear(&bytes)?,
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return Ok(()),
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
        Ok(())
    }
}
