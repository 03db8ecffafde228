//! Counts what a motion costs on a chip: instructions by part, flash and memory.
//!
//! In:  blobs, a [`Target`].
//! Out: a [`Row`] for each.
//!
//! Why here: one build serves all blobs of a number format on a target, because a blob is put into memory by the
//! emulator. QEMU counts instructions and models neither pipeline nor flash: no row says anything about time.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;
use karakuri::{Model, NumberFormat};
use tempfile::{TempDir, TempPath};

use crate::error::{Error, Result};
use crate::executable::Executable;
use crate::firmware::{BenchmarkFirmware, partition_bytes};
use crate::plugin::build_plugin;
use crate::qemu::{self, Extras, Qemu};
use crate::region_counts::parse_region_counts;
use crate::target::Target;

mod frame_rate;
mod measurements;
mod row;

pub use frame_rate::{Estimate, QEMU_COUNTS_INSTRUCTIONS};
pub use row::{PartCounts, Row};

use measurements::Measurements;

/// Width of the programs' workspace, so that counts do not depend on which blobs are counted together.
const WIDTH: usize = 1024;
/// Symbol of the place where the programs expect a blob.
const PARTITION: &str = "_blob_partition";
/// The longest step, a pose of floats in software at the paper's size, takes seconds.
const SILENCE_MAX: Duration = Duration::from_secs(120);

/// A blob to be counted.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Name in reports: of the network, or of the file.
    pub network: String,
    /// The blob.
    pub blob: Vec<u8>,
}

/// The emulator with its counter, and a place for their files.
pub struct Bench {
    qemu: Qemu<'static>,
    plugin: TempPath,
    folder: TempDir,
}

impl Bench {
    /// Looks for the tools.
    ///
    /// # Errors
    /// [`Error::MissingTool`] without QEMU or a C compiler; [`Error::Build`], [`Error::Io`].
    pub fn new() -> Result<Self> {
        let qemu = Qemu { program: qemu::PROGRAM, silence_max: SILENCE_MAX };
        let plugin = build_plugin(qemu)?;
        let folder =
            tempfile::tempdir().map_err(Error::io("create a folder in", std::env::temp_dir()))?;
        Ok(Self { qemu, plugin, folder })
    }

    /// Counts every subject on a target, format by format; `progress` grows by one for each.
    ///
    /// # Errors
    /// [`Error::Blob`]; [`Error::MissingTool`] without a cross-compiler; [`Error::Build`]; [`Error::Firmware`] if the
    /// program fails or says something else than expected.
    pub fn rows(
        &self,
        subjects: &[Subject],
        target: Target,
        progress: &ProgressBar,
    ) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        for format in NumberFormat::ALL {
            let models = subjects.iter().map(|subject| Ok((subject, model(subject)?)));
            let models: Vec<_> = models.collect::<Result<_>>()?;
            let of_format: Vec<_> =
                models.iter().filter(|(_, model)| model.number_format() == format).collect();
            let Some(width) = of_format.iter().map(|(_, model)| model.workspace_width()).max()
            else {
                continue;
            };
            progress.set_message(format!("building {} for {}", format.name(), target.name()));
            let firmware = BenchmarkFirmware::build(format, width.max(WIDTH), target)?;
            for (subject, model) in of_format {
                progress.set_message(format!("counting {} on {}", subject.network, target.name()));
                rows.push(self.row(subject, model, &firmware, target)?);
                progress.inc(1);
            }
        }
        Ok(rows)
    }

    fn row(
        &self,
        subject: &Subject,
        model: &Model<'_>,
        firmware: &BenchmarkFirmware,
        target: Target,
    ) -> Result<Row> {
        let [counter, minimal] = [&firmware.counter, &firmware.minimal]
            .map(|program| fs::read(program.elf()).map_err(Error::io("read", program.elf())));
        let (counter, minimal) = (counter?, minimal?);
        let program = Executable::parse(&counter)?;
        let flash = self.folder.path().join("partition.bin");
        fs::write(&flash, partition_bytes(&subject.blob)).map_err(Error::io("write", &flash))?;
        let counts = self.folder.path().join("counts.txt");
        let extras = Extras {
            memory: Some((&flash, program.symbol_address(PARTITION)?)),
            plugin: Some((&self.plugin, &counts)),
        };
        let measurements = self.run(extras, firmware, target, counts.clone())?;
        let minimal = Executable::parse(&minimal)?;
        Row::new(subject, model, target, &firmware.compiler, &measurements, &program, &minimal)
    }

    fn run(
        &self,
        extras: Extras<'_>,
        firmware: &BenchmarkFirmware,
        target: Target,
        counts: PathBuf,
    ) -> Result<Measurements> {
        let mut measurements = Measurements::default();
        let mut unreadable = None;
        self.qemu.run_with(extras, firmware.counter.elf(), target, |line| {
            if let Err(error) = measurements.read_line(line) {
                unreadable.get_or_insert(error);
            }
        })?;
        unreadable.map_or(Ok(()), Err)?;
        let text = fs::read_to_string(&counts).map_err(Error::io("read", &counts))?;
        measurements.add_counts(parse_region_counts(&text)?)?;
        Ok(measurements)
    }
}

fn model(subject: &Subject) -> Result<Model<'_>> {
    let in_file = |error: Error| error.in_file(subject.network.as_ref());
    Model::from_bytes(&subject.blob).map_err(|error| in_file(error.into()))
}
