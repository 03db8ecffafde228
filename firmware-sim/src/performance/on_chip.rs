//! The same performance on an emulated chip.
//!
//! In:  the blob, stint and cues; the host's numbers.
//! Out: [`ChipPerformance`]: how many bits differ, memory, and instructions a tick where they are counted.
//!
//! Why here: an hour of idling, interrupting and failing on the chip must be the host's hour, command by command.

use std::fs;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use serde::Serialize;
use tempfile::{NamedTempFile, TempPath};

use super::{InstructionsPerTick, Performance};
use crate::cue::{Cue, Stint};
use crate::error::{Error, Result};
use crate::executable::Executable;
use crate::firmware::Firmware;
use crate::parity::{Differences, check_complete, compare_bits};
use crate::plugin::build_plugin;
use crate::qemu::{self, Extras, Qemu};
use crate::region_counts::parse_region_counts;
use crate::target::Target;
use crate::transcript::{Ram, Transcript};

/// A tick of a large model on a slow emulated chip takes milliseconds; longer silence is a hang.
const SILENCE_MAX: Duration = Duration::from_secs(120);
/// Ticks that are counted at most, a minute's: the counter writes some ten kilobytes for each.
pub const COUNTED_TICKS_MAX: u32 = 3000;

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
    /// Instructions under QEMU, which models no pipeline, no flash and no cache; none where nobody asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instructions_per_tick: Option<InstructionsPerTick>,
    /// Duration of the emulation. It says nothing about the chip.
    pub emulation_s: f64,
}

/// What the program on the chip reads: the stint, then the cues.
pub fn program_input(stint: Stint, cues: &[Cue]) -> Vec<u8> {
    let cues = cues.iter().flat_map(Cue::to_bytes);
    stint.to_bytes().into_iter().chain(cues).collect()
}

/// Performs on the chip what `host` performed, compares, and counts instructions if `is_counted`.
///
/// # Errors
/// [`Error::MissingTool`] without QEMU or cross-compiler; [`Error::Build`]; [`Error::Firmware`] if the program does not
/// end, or not with one line a tick. A difference is none.
pub fn perform_on_chip(
    blob: &[u8],
    cues: &[Cue],
    host: &Performance,
    target: Target,
    is_counted: bool,
    progress: &ProgressBar,
) -> Result<ChipPerformance> {
    let qemu = Qemu { program: qemu::PROGRAM, silence_max: SILENCE_MAX };
    qemu.check_installed()?;
    let counter = is_counted.then(|| Counter::new(qemu)).transpose()?;
    progress.set_message(format!("building for {}", target.name()));
    let firmware = Firmware::build_performer(blob, &program_input(host.stint, cues), target)?;
    progress.set_length(host.numbers.len() as u64);
    progress.set_message(format!("performing on {}", target.machine()));
    let start = Instant::now();
    let mut transcript = Transcript::default();
    let mut unreadable = None;
    let extras = counter.as_ref().map_or_else(Extras::default, Counter::extras);
    qemu.run_with(extras, firmware.elf(), target, |line| {
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
        instructions_per_tick: counter.map(|counter| counter.read(host, &firmware)).transpose()?,
        emulation_s,
    })
}

/// The plugin, and a place for what it writes.
struct Counter {
    plugin: TempPath,
    counts: TempPath,
}

impl Counter {
    fn new(qemu: Qemu<'_>) -> Result<Self> {
        let counts = NamedTempFile::new().map_err(Error::io("create", std::env::temp_dir()))?;
        Ok(Self { plugin: build_plugin(qemu)?, counts: counts.into_temp_path() })
    }

    fn extras(&self) -> Extras<'_> {
        Extras { memory: None, plugin: Some((&self.plugin, &self.counts)) }
    }

    /// # Errors
    /// [`Error::Firmware`] unless there is a region for each tick.
    fn read(&self, host: &Performance, firmware: &Firmware) -> Result<InstructionsPerTick> {
        let text = fs::read_to_string(&self.counts).map_err(Error::io("read", &self.counts))?;
        let regions = parse_region_counts(&text)?;
        if regions.len() != host.ticks.len() {
            let log = format!("{} ticks, {} counts", host.ticks.len(), regions.len());
            return Err(Error::Firmware { reason: "incomplete counts".into(), log });
        }
        let elf = fs::read(firmware.elf()).map_err(Error::io("read", firmware.elf()))?;
        Ok(InstructionsPerTick::new(&regions, &host.ticks, &Executable::parse(&elf)?))
    }
}
