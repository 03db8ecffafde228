//! The same performance on an emulated chip.
//!
//! In:  the blob, stint and cues; the host's numbers.
//! Out: [`ChipPerformance`]: how many bits differ, memory, and instructions a tick where they are counted.
//!
//! Why here: an hour of idling, interrupting and failing on the chip must be the host's hour, command by command.

use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use serde::Serialize;

use super::Performance;
use crate::cue::{Cue, Stint};
use crate::error::{Error, Result};
use crate::firmware::Firmware;
use crate::parity::{Differences, check_complete, compare_bits};
use crate::qemu::{self, Qemu};
use crate::target::Target;
use crate::transcript::{Ram, Transcript};

/// A tick of a large model on a slow emulated chip takes milliseconds; longer silence is a hang.
const SILENCE_MAX: Duration = Duration::from_secs(120);

/// Host against chip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChipPerformance {
    /// Name of the target.
    pub target: &'static str,
    /// Ticks compared.
    pub ticks: usize,
    /// Pulses compared.
    pub commands: usize,
    /// Pulses and limits, bit by bit; a pose is a tick here, a channel a number of it.
    pub differences: Differences,
    /// Memory that the program used.
    pub ram: Ram,
    /// Duration of the emulation. It says nothing about the chip.
    pub emulation_s: f64,
}

/// What the program on the chip reads: the stint, then the cues.
pub fn program_input(stint: Stint, cues: &[Cue]) -> Vec<u8> {
    let cues = cues.iter().flat_map(Cue::to_bytes);
    stint.to_bytes().into_iter().chain(cues).collect()
}

/// Performs on the chip what `host` performed, and compares.
///
/// # Errors
/// [`Error::MissingTool`] without QEMU or cross-compiler; [`Error::Build`]; [`Error::Firmware`] if the program does not
/// end, or not with one line a tick. A difference is none.
pub fn perform_on_chip(
    blob: &[u8],
    cues: &[Cue],
    host: &Performance,
    target: Target,
    progress: &ProgressBar,
) -> Result<ChipPerformance> {
    let qemu = Qemu { program: qemu::PROGRAM, silence_max: SILENCE_MAX };
    qemu.check_installed()?;
    progress.set_message(format!("building for {}", target.name()));
    let firmware = Firmware::build_performer(blob, &program_input(host.stint, cues), target)?;
    progress.set_length(host.numbers.len() as u64);
    progress.set_message(format!("performing on {}", target.machine()));
    let start = Instant::now();
    let mut transcript = Transcript::default();
    let mut unreadable = None;
    qemu.run(firmware.elf(), target, |line| {
        if let Err(error) = transcript.read_line(line) {
            unreadable.get_or_insert(error);
        }
        progress.set_position(transcript.poses.len() as u64);
    })?;
    unreadable.map_or(Ok(()), |error: Error| Err(error))?;
    let emulation_s = start.elapsed().as_secs_f64();
    let ram = check_complete(&transcript, &host.numbers)?;
    Ok(ChipPerformance {
        target: target.name(),
        ticks: host.numbers.len(),
        commands: host.numbers.iter().map(|numbers| numbers.len() - 1).sum(),
        differences: compare_bits(&host.numbers, &transcript.poses),
        ram,
        emulation_s,
    })
}
