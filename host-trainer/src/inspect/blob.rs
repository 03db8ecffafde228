//! What a blob contains, for people and for scripts.
//!
//! In:  the bytes of a `.kara` file.
//! Out: [`BlobReport`], printed by `inspect` and `quantize` and part of the demo's closing table.

use std::fmt;
use std::path::Path;

use karakuri::manifest::tensor_plan;
use karakuri::servo_records::servos_bytes;
use karakuri::{ActionId, Model};
use serde::Serialize;

use crate::error::{Error, Result};
use crate::table::{Table, thousands};

/// Everything that a blob says about itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BlobReport {
    /// What the model was trained on.
    pub name: String,
    /// `w8a16`, `w8a8`, `w4a8` or `f16`.
    pub format: &'static str,
    /// Poses per second.
    pub rate_hz: f64,
    /// Groups of the layout.
    pub groups: Vec<GroupReport>,
    /// Actions and the lengths that they were trained at.
    pub actions: Vec<ActionReport>,
    /// `inputs → outputs` of code half, time half and every further layer.
    pub layers: Vec<(u16, u16)>,
    /// How codes are drawn.
    pub sampler: &'static str,
    /// Clips' codes or Gaussians in the sampler.
    pub component_count: u32,
    /// Length intervals of all actions together.
    pub interval_count: u16,
    /// Numbers of β and of α.
    pub code_counts: (u16, u16),
    /// Servos that it is calibrated for.
    pub servo_count: usize,
    /// Bytes by part; their sum is `bytes`.
    pub parts: Vec<PartReport>,
    /// Length of the file.
    pub bytes: usize,
    /// RAM of a workspace that fits, a pose and a code.
    pub ram_bytes: usize,
    /// Once a motion.
    pub multiply_accumulates_per_motion: u64,
    /// Every pose.
    pub multiply_accumulates_per_pose: u64,
    /// SHA-256 of the training configuration, hexadecimal.
    pub config_hash: String,
    /// Seed of the training.
    pub seed: u64,
}

/// One group of channels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupReport {
    /// Joint or servo.
    pub name: String,
    /// What the channels are.
    pub kind: &'static str,
    /// Suffix of the unit.
    pub unit: &'static str,
}

/// One action.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActionReport {
    /// Its name.
    pub name: String,
    /// Shortest trained motion.
    pub seconds_min: f64,
    /// Longest trained motion.
    pub seconds_max: f64,
}

/// Bytes of one part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PartReport {
    /// `weights`, `biases`, …
    pub part: &'static str,
    /// Its size.
    pub bytes: u64,
}

impl BlobReport {
    /// Reads a blob; `path` is for error messages.
    pub fn new(path: &Path, blob: &[u8]) -> Result<Self> {
        let model = load(path, blob)?;
        let manifest = model.manifest();
        Ok(Self {
            name: manifest.name.into(),
            format: manifest.number_format.name(),
            rate_hz: f64::from(manifest.rate_millihz) / 1000.0,
            groups: groups_of(&model),
            actions: actions_of(&model),
            layers: manifest
                .layers
                .iter()
                .map(|shape| (shape.input_count, shape.output_count))
                .collect(),
            sampler: manifest.sampler.kind.name(),
            component_count: manifest.sampler.component_count,
            interval_count: manifest.sampler.interval_count,
            code_counts: (manifest.sequence_code_count, manifest.action_code_count),
            servo_count: model.servos().count(),
            parts: parts_of(&model, blob.len()),
            bytes: blob.len(),
            ram_bytes: ram_bytes(&model),
            multiply_accumulates_per_motion: model.multiply_accumulates_per_motion(),
            multiply_accumulates_per_pose: model.multiply_accumulates_per_pose(),
            config_hash: manifest
                .provenance
                .config_hash
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect(),
            seed: manifest.provenance.seed,
        })
    }
}

/// The bytes of a blob's file.
pub fn read_blob(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(Error::io("read", path))
}

/// `Model::from_bytes` with the file's name in the error.
pub fn load<'a>(path: &Path, blob: &'a [u8]) -> Result<Model<'a>> {
    Model::from_bytes(blob)
        .map_err(|reason| Error::Blob { path: path.into(), reason: reason.to_string() })
}

fn groups_of(model: &Model<'_>) -> Vec<GroupReport> {
    let report = |group: karakuri::manifest::Group<'_>| GroupReport {
        name: group.name.into(),
        kind: group.kind.name(),
        unit: group.unit.suffix(),
    };
    model.groups().map(report).collect()
}

fn actions_of(model: &Model<'_>) -> Vec<ActionReport> {
    let rate_hz = f64::from(model.rate_millihz()) / 1000.0;
    let report = |(action, name): (u16, &str)| {
        let frames = model.trained_frames(ActionId(action));
        let seconds = |frames: u32| f64::from(frames) / rate_hz;
        ActionReport {
            name: name.into(),
            seconds_min: seconds(*frames.start()),
            seconds_max: seconds(*frames.end()),
        }
    };
    (0..).zip(model.actions()).map(report).collect()
}

fn parts_of(model: &Model<'_>, bytes: usize) -> Vec<PartReport> {
    let mut parts: Vec<PartReport> = Vec::new();
    for (kind, length) in tensor_plan(model.manifest()).filter(|(_, length)| *length > 0) {
        match parts.iter_mut().find(|report| report.part == kind.part()) {
            Some(report) => report.bytes += length,
            None => parts.push(PartReport { part: kind.part(), bytes: length }),
        }
    }
    let servo_count = model.servos().count();
    if servo_count > 0 {
        parts.push(PartReport { part: "servos", bytes: servos_bytes(servo_count) as u64 });
    }
    let rest = bytes as u64 - parts.iter().map(|report| report.bytes).sum::<u64>();
    parts.push(PartReport { part: "header, names, alignment", bytes: rest });
    parts
}

/// Widest-layer buffers of the format's arithmetic, and one pose and one code at their limits.
fn ram_bytes(model: &Model<'_>) -> usize {
    let per_width = match model.number_format() {
        karakuri::NumberFormat::F16 => 4 + 2 * 4,
        _ => 4 + 2 * 2,
    };
    model.workspace_width() * per_width
        + std::mem::size_of::<karakuri::Pose>()
        + std::mem::size_of::<karakuri::Code>()
}

impl fmt::Display for BlobReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let layers: Vec<String> =
            self.layers.iter().map(|(inputs, outputs)| format!("{inputs}→{outputs}")).collect();
        writeln!(out, "{} ({}, {} Hz, seed {})", self.name, self.format, self.rate_hz, self.seed)?;
        writeln!(out, "config      {}", self.config_hash)?;
        writeln!(out, "layers      {}  (code half, time half, …)", layers.join("  "))?;
        writeln!(
            out,
            "sampler     {}: {} components in {} length intervals; codes of {} + {} numbers",
            self.sampler,
            self.component_count,
            self.interval_count,
            self.code_counts.0,
            self.code_counts.1
        )?;
        writeln!(
            out,
            "work        {} multiply-accumulates a pose, {} more at the start of a motion",
            thousands(self.multiply_accumulates_per_pose),
            thousands(self.multiply_accumulates_per_motion)
        )?;
        if self.servo_count > 0 {
            writeln!(out, "servos      {}, calibrated", self.servo_count)?;
        }
        writeln!(out, "RAM         {} bytes\n", thousands(self.ram_bytes as u64))?;
        let mut actions = Table::new(["action", "shortest s", "longest s"]);
        for action in &self.actions {
            let seconds = |seconds: f64| format!("{seconds:.2}");
            actions.push([
                action.name.clone(),
                seconds(action.seconds_min),
                seconds(action.seconds_max),
            ]);
        }
        writeln!(out, "{actions}")?;
        let mut groups = Table::new(["group", "kind", "unit"]);
        for group in &self.groups {
            groups.push([group.name.clone(), group.kind.into(), group.unit.into()]);
        }
        writeln!(out, "{groups}")?;
        let mut parts = Table::new(["part", "bytes"]);
        for report in &self.parts {
            parts.push([report.part.into(), thousands(report.bytes)]);
        }
        parts.push(["all".into(), thousands(self.bytes as u64)]);
        write!(out, "{parts}")
    }
}
