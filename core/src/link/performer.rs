//! A body at the end of a line: commands of the link → player, what the player does → reports.
//!
//! In:  bytes of the line, one by one; the time since the last tick.
//! Out: servo commands, and [`Report`]s for whoever owns the line to encode and send.
//!
//! Why here: firmware, simulator and C library answer a host alike. It owns no line and no flash: a program that takes
//! blobs brings a [`BlobSink`], and makes a new player where one was committed. Blobs are taken only while the servos
//! are released: writing flash stops many chips for longer than a tick, and the body that starts anew with the blob
//! drops its limbs. Whoever directs it says `relax` first, and sees that it lies safely; holding is not enough.

use super::{
    Arrival, BlobSink, CHUNK_HEAD_BYTES_MAX, Command, DialSettings, Inbox, Loader, Mode, Play,
    Refusal, Report, receiver_bytes,
};
use crate::dials::Dials;
use crate::error::PlayError;
use crate::intent::Intent;
use crate::model::ActionId;
use crate::player::{Player, PlayerState};

/// Reports that wait to be taken; more are left out.
const REPORTS_MAX: usize = 4;

/// Longest chunk whose length fits into the two bytes that [`CHUNK_HEAD_BYTES_MAX`] counts for it.
const CHUNK_BYTES_MAX: usize = 16_383;

/// Answers a host for a player. `N`: bytes of the longest command, see [`receiver_bytes`] of
/// [`COMMAND_BYTES_MAX`](super::COMMAND_BYTES_MAX), or of [`CHUNK_HEAD_BYTES_MAX`] and the chunks of a blob.
#[derive(Debug, Default)]
pub struct Performer<const N: usize> {
    inbox: Inbox<N>,
    reports: heapless::Deque<Report, REPORTS_MAX>,
    ticks: u32,
    interventions: u32,
    fault_code: u16,
}

impl<const N: usize> Performer<N> {
    /// A performer without a session.
    pub const fn new() -> Self {
        Self {
            inbox: Inbox::new(),
            reports: heapless::Deque::new(),
            ticks: 0,
            interventions: 0,
            fault_code: 0,
        }
    }

    /// Takes the next byte of the line and does what a frame that ends there says; blobs are not taken.
    pub fn hear<const CHANNELS: usize>(&mut self, byte: u8, player: &mut Player<'_, '_, CHANNELS>) {
        self.hear_with(byte, player, 0, |_, _| Err(Refusal::NotSupported));
    }

    /// [`hear`](Self::hear), and takes blobs into `sink`, in chunks as long as `N` has room for. `true` where a blob
    /// was committed: send the reports that wait, then reset, or make a new player of the new blob. A performer that is
    /// kept knows its session, and repeats the acknowledgement if that got lost.
    ///
    /// [`Refusal::NotRelaxed`] where the servos are not released. After any refusal the player goes on with its
    /// model, so `sink` must keep the blob that is played until the commit.
    #[must_use = "the player plays from the blob of before"]
    pub fn hear_or_load<const CHANNELS: usize>(
        &mut self,
        byte: u8,
        player: &mut Player<'_, '_, CHANNELS>,
        loader: &mut Loader,
        sink: &mut impl BlobSink,
    ) -> bool {
        let room = N.saturating_sub(receiver_bytes(CHUNK_HEAD_BYTES_MAX)).min(CHUNK_BYTES_MAX);
        let mut is_committed = false;
        self.hear_with(byte, player, room as u16, |command, state| {
            if state != PlayerState::Released {
                return Err(Refusal::NotRelaxed);
            }
            loader.obey(command, sink)?;
            is_committed = *command == Command::LoadCommit;
            Ok(())
        });
        is_committed
    }

    fn hear_with<const CHANNELS: usize>(
        &mut self,
        byte: u8,
        player: &mut Player<'_, '_, CHANNELS>,
        chunk_bytes_max: u16,
        load: impl FnOnce(&Command<'_>, PlayerState) -> Result<(), Refusal>,
    ) {
        let (sequence, outcome, answer) = match self.inbox.push(byte) {
            None => return,
            Some(Arrival::Answer(report)) => return self.report(report),
            Some(Arrival::Act { sequence, command }) => {
                let outcome = obey(&command, player, load);
                (sequence, outcome, answer(&command, player, chunk_bytes_max))
            }
        };
        let report = self.inbox.answer(sequence, outcome);
        self.report(report);
        answer.into_iter().for_each(|report| self.report(report));
    }

    /// To be called after every tick of the player: counts, and reports a fault when one is latched.
    pub fn ticked<const CHANNELS: usize>(&mut self, player: &Player<'_, '_, CHANNELS>) {
        self.ticks = self.ticks.saturating_add(1);
        let limited = player.command().limited_servos().count_ones();
        self.interventions = self.interventions.saturating_add(limited);
        let code = match player.state() {
            PlayerState::Faulted(fault) => fault.code(),
            _ => 0,
        };
        if code != 0 && code != self.fault_code {
            self.report(Report::Fault { code });
        }
        self.fault_code = code;
    }

    /// What was commanded at the last tick; to be sent as often as the line allows.
    pub fn telemetry<const CHANNELS: usize>(&self, player: &Player<'_, '_, CHANNELS>) -> Report {
        Report::Telemetry {
            tick: self.ticks,
            interventions: self.interventions,
            broken_frames: self.inbox.broken_frames(),
            pulses_us: player.command().pulses_us().iter().copied().collect(),
        }
    }

    /// The oldest report that has not been taken.
    pub fn take_report(&mut self) -> Option<Report> {
        self.reports.pop_front()
    }

    fn report(&mut self, report: Report) {
        // A line that nobody empties loses the newest; the host then asks again.
        let _ = self.reports.push_back(report);
    }
}

/// Does what a command says; `load`: what to do with those that bring a blob.
fn obey<const CHANNELS: usize>(
    command: &Command<'_>,
    player: &mut Player<'_, '_, CHANNELS>,
    load: impl FnOnce(&Command<'_>, PlayerState) -> Result<(), Refusal>,
) -> Result<(), Refusal> {
    match *command {
        Command::Hello | Command::Query => {}
        Command::Play(play) => return begin(play, player),
        Command::Hold => player.hold(),
        Command::SoftStop => player.soft_stop(),
        Command::Relax => player.relax(),
        Command::Wake => player.wake(),
        Command::Resume => player.resume(),
        Command::ClearFault => player.clear_fault(),
        Command::SetDials(dials) => return turn(dials, player),
        Command::Idle { actions } => {
            let count = player.model().manifest().action_count;
            let is_chosen = |&index: &u16| actions.unbounded_shr(index.into()) & 1 == 1;
            player.idle((0..count).filter(is_chosen).map(ActionId));
        }
        Command::LoadBegin { .. } | Command::LoadChunk { .. } | Command::LoadCommit => {
            return load(command, player.state());
        }
    }
    Ok(())
}

fn begin<const CHANNELS: usize>(
    play: Play,
    player: &mut Player<'_, '_, CHANNELS>,
) -> Result<(), Refusal> {
    let count = player.model().manifest().action_count;
    match player.state() {
        _ if play.action >= count => return Err(Refusal::UnknownAction { count }),
        PlayerState::Faulted(fault) => return Err(Refusal::Faulted { code: fault.code() }),
        PlayerState::Released => return Err(Refusal::Asleep),
        _ => {}
    }
    let intent = Intent::new(ActionId(play.action), play.duration_ms, play.seed);
    let intent = intent.over_ms(play.transition_ms);
    let begun = if play.then { player.then(intent) } else { player.play(intent) };
    begun.map_err(|error| match error {
        PlayError::QueueFull { .. } => Refusal::QueueFull,
        _ => Refusal::BadDuration,
    })
}

fn turn<const CHANNELS: usize>(
    settings: DialSettings,
    player: &mut Player<'_, '_, CHANNELS>,
) -> Result<(), Refusal> {
    let DialSettings { intensity_q12, rate_q12, stillness_q12, variety_q12 } = settings;
    let dials = Dials { intensity_q12, rate_q12, stillness_q12, variety_q12 };
    if dials.clamped() != dials {
        return Err(Refusal::BadDials);
    }
    player.set_dials(dials);
    Ok(())
}

/// The report that a command asks for, beside its acknowledgement.
fn answer<const CHANNELS: usize>(
    command: &Command<'_>,
    player: &Player<'_, '_, CHANNELS>,
    chunk_bytes_max: u16,
) -> Option<Report> {
    match command {
        Command::Hello => Some(hello(player, chunk_bytes_max)),
        Command::Query => Some(state(player)),
        _ => None,
    }
}

fn hello<const CHANNELS: usize>(player: &Player<'_, '_, CHANNELS>, chunk_bytes_max: u16) -> Report {
    let manifest = player.model().manifest();
    Report::Hello {
        model_hash: manifest.provenance.config_hash.first_chunk().copied().unwrap_or_default(),
        action_count: manifest.action_count,
        servo_count: player.command().pulses_us().len() as u8,
        chunk_bytes_max,
    }
}

fn state<const CHANNELS: usize>(player: &Player<'_, '_, CHANNELS>) -> Report {
    let (mode, action) = match player.state() {
        PlayerState::Released => (Mode::Relaxed, None),
        PlayerState::Faulted(_) => (Mode::Faulted, None),
        PlayerState::Held => (Mode::Holding, None),
        PlayerState::Moving(ActionId(action)) => (Mode::Playing, Some(action)),
        PlayerState::Resting => (Mode::Resting, None),
    };
    Report::State { mode, action }
}

#[cfg(test)]
mod tests;
