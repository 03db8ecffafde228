//! What a run shows of itself: `metrics.jsonl`, `loss.svg`, and errors in units that a person can picture.
//!
//! In:  step reports of `train`.
//! Out: one JSON line about every second; a plot of all lines.

mod plot;

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use karakuri::{GroupKind, Unit};
use serde::{Deserialize, Serialize};

use crate::dataset::DatasetDescription;
use crate::error::{Error, Result};
use crate::train::step::StepReport;

pub use plot::plot_losses;

/// One line of `metrics.jsonl`: means over the steps since the line before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricLine {
    /// Steps done.
    pub step: u64,
    /// Reconstruction and divergence together.
    pub loss: f64,
    /// Weighted squared error.
    pub reconstruction: f64,
    /// Weighted KL of both code tables.
    pub divergence: f64,
    /// Root of the mean square of every channel of a kind, e.g. `translation_mm`.
    pub error_rms: BTreeMap<String, f64>,
    /// Learning rate of the decoder.
    pub decoder_learning_rate: f64,
    /// Learning rate of the codes.
    pub code_learning_rate: f64,
    /// Steps per second.
    pub steps_per_s: f64,
}

/// The channels of one kind and unit, which share a column in reports.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorColumn {
    /// Kind and unit: `translation_mm`.
    pub name: String,
    /// What the channels are.
    pub kind: GroupKind,
    /// The channels' indices.
    pub channels: Vec<usize>,
    /// The column's unit per unit of the channel: 1000 from metres to millimetres.
    pub factor: f64,
}

/// Unit in which errors of a channel's unit are reported, and how many of it make one of the channel's.
pub fn report_unit(unit: Unit) -> (&'static str, f64) {
    match unit {
        Unit::Metre => ("mm", 1000.0),
        Unit::Centimetre => ("mm", 10.0),
        Unit::Radian => ("deg", 180.0 / core::f64::consts::PI),
        Unit::One | Unit::Degree | Unit::Millimetre | Unit::Microsecond => (unit.suffix(), 1.0),
    }
}

/// The columns of a layout, in the order of the kinds.
pub fn error_columns(description: &DatasetDescription) -> Vec<ErrorColumn> {
    let mut columns: Vec<ErrorColumn> = Vec::new();
    for kind in GroupKind::ALL {
        for (group, channels) in description.layout.ranges().filter(|(group, _)| group.kind == kind)
        {
            let (unit, factor) = report_unit(group.unit);
            let name = format!("{}_{unit}", kind.name());
            match columns.iter_mut().find(|column| column.name == name && column.factor == factor) {
                Some(column) => column.channels.extend(channels),
                None => {
                    columns.push(ErrorColumn { name, kind, channels: channels.collect(), factor })
                }
            }
        }
    }
    columns
}

/// Sums over the steps between two lines.
#[derive(Clone, Debug)]
pub struct MetricSums {
    columns: Vec<ErrorColumn>,
    /// Channel units per 1 of the standardised error. // (channel)
    scale: Vec<f32>,
    step_count: usize,
    row_count: usize,
    reconstruction: f64,
    divergence: f64,
    squared_errors: Vec<f64>,
}

impl MetricSums {
    /// Before the first step.
    pub fn new(description: &DatasetDescription) -> Self {
        Self {
            columns: error_columns(description),
            scale: description.scale.clone(),
            step_count: 0,
            row_count: 0,
            reconstruction: 0.0,
            divergence: 0.0,
            squared_errors: vec![0.0; description.scale.len()],
        }
    }

    /// Adds one step.
    pub fn add(&mut self, report: &StepReport) {
        self.step_count += 1;
        self.row_count += report.row_count;
        self.reconstruction += report.reconstruction;
        self.divergence += report.divergence;
        for (sum, squares) in self.squared_errors.iter_mut().zip(&report.squared_errors) {
            *sum += squares;
        }
    }

    /// The line of all steps since the last call, and a fresh start; rates and speed are the caller's to fill in.
    pub fn take_line(&mut self, step: u64) -> Option<MetricLine> {
        let step_count = self.step_count as f64;
        if self.step_count == 0 {
            return None;
        }
        let line = MetricLine {
            step,
            loss: (self.reconstruction + self.divergence) / step_count,
            reconstruction: self.reconstruction / step_count,
            divergence: self.divergence / step_count,
            error_rms: self.columns.iter().map(|c| (c.name.clone(), self.rms(c))).collect(),
            decoder_learning_rate: 0.0,
            code_learning_rate: 0.0,
            steps_per_s: 0.0,
        };
        (self.step_count, self.row_count) = (0, 0);
        (self.reconstruction, self.divergence) = (0.0, 0.0);
        self.squared_errors.fill(0.0);
        Some(line)
    }

    fn rms(&self, column: &ErrorColumn) -> f64 {
        let square = |&channel: &usize| {
            self.squared_errors[channel] * (f64::from(self.scale[channel]) * column.factor).powi(2)
        };
        let count = (self.row_count * column.channels.len()) as f64;
        (column.channels.iter().map(square).sum::<f64>() / count).sqrt()
    }
}

/// The history of a run, in memory and in `metrics.jsonl`.
#[derive(Clone, Debug)]
pub struct MetricLog {
    path: PathBuf,
    /// All lines so far.
    pub lines: Vec<MetricLine>,
}

impl MetricLog {
    /// Name of the file in a run's folder.
    pub const FILE_NAME: &'static str = "metrics.jsonl";

    /// Opens the history; lines after `step` belong to work that a kill has lost, and are cut off.
    ///
    /// # Errors
    /// `Io` when the file cannot be read or written.
    pub fn open(run: &Path, step: u64) -> Result<Self> {
        let path = run.join(Self::FILE_NAME);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(Error::io("read", &path)(error)),
        };
        let parsed = text.lines().map_while(|line| serde_json::from_str(line).ok());
        let lines: Vec<_> = parsed.take_while(|line: &MetricLine| line.step <= step).collect();
        crate::atomic_file::replace(&path, |file| {
            lines.iter().try_for_each(|line| writeln!(file, "{}", json(line)))
        })?;
        Ok(Self { path, lines })
    }

    /// Adds a line to memory and file.
    ///
    /// # Errors
    /// `Io` when the file cannot be written.
    pub fn push(&mut self, line: MetricLine) -> Result<()> {
        let append = || {
            let mut file = OpenOptions::new().append(true).create(true).open(&self.path)?;
            writeln!(file, "{}", json(&line))
        };
        append().map_err(Error::io("write", &self.path))?;
        self.lines.push(line);
        Ok(())
    }
}

fn json(line: &MetricLine) -> String {
    serde_json::to_string(line).unwrap_or_else(|error| unreachable!("plain numbers: {error}"))
}
