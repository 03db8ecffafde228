//! What the stages of a row found, as it stands in files and in `--json`.
//!
//! In:  `stages`.
//! Out: the stages' files, `report`, `--json`.

use serde::{Deserialize, Serialize};

use crate::reconstruct::Reconstruction;
use crate::reproduce::experiments::PaperFigures;

/// A row of the report.
#[derive(Clone, Debug, Serialize)]
pub struct RowRecord {
    /// Its name.
    pub name: String,
    /// What it is.
    pub about: String,
    /// What the paper prints for the same experiment.
    pub beside: Option<PaperFigures>,
    /// What it trained on all clips gives, or the error that ended it.
    pub result: Outcome,
    /// The same of its twin that has not seen some clips.
    pub held_out: Option<Outcome>,
}

/// How a job ended.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It was done.
    Done(JobRecord),
    /// It was not.
    Failed(String),
}

/// All that one training gave.
#[derive(Clone, Debug, Serialize)]
pub struct JobRecord {
    /// How it was trained.
    pub training: TrainingRecord,
    /// What its float model and its blobs give.
    pub sources: Vec<SourceRecord>,
}

/// Result of the stage `train`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// SHA-256 of the settings, hexadecimal.
    pub config_hash: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// Steps done.
    pub steps: u64,
    /// Steps that the preset asks for.
    pub preset_steps: u64,
    /// Passes over the clips.
    pub passes: f64,
    /// Wall time of all steps.
    pub seconds: f64,
    /// Clips trained on.
    pub clip_count: usize,
    /// Clips held out.
    pub held_out_count: usize,
    /// Weights and biases of the decoder.
    pub parameter_count: usize,
}

/// Result of the stages `quantize` and `evaluate` of one source of poses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SourceRecord {
    /// `float`, or the blob's number format.
    pub source: String,
    /// Multiply-accumulates of a pose.
    pub macs_per_pose: u64,
    /// How well training clips come back.
    pub reconstruction: ReconstructionRecord,
    /// The blob; `None` for the float model.
    pub blob: Option<BlobRecord>,
    /// How its generated motions look to a classifier; `None` where nothing was measured.
    pub evaluation: Option<EvaluationRecord>,
}

/// A figure over the repetitions of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Mean over the repetitions.
    pub mean: f64,
    /// Half width of its 95 % interval.
    pub ci95: f64,
}

/// Result of the stage `evaluate`: the part of `host-trainer evaluate --json` that a report shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationRecord {
    /// Fréchet inception distance to the training clips.
    pub fid: Figure,
    /// The same to the clips that training did not see.
    pub fid_held_out: Option<Figure>,
    /// Share of motions whose action is recognised.
    pub accuracy: Figure,
    /// Diversity.
    pub diversity: Figure,
    /// Multimodality.
    pub multimodality: Figure,
    /// Mean distance to the nearest training clip's features.
    pub mms: Option<Figure>,
    /// Average pairwise distance, metres.
    pub apd: Option<Figure>,
    /// The same as a share of the real motions', per cent.
    pub apd_normalized: Option<Figure>,
    /// Real motions against real motions.
    pub real: Option<Box<EvaluationRecord>>,
}

/// How well a decoder gives its training clips back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReconstructionRecord {
    /// Multiply-accumulates of a pose.
    pub macs_per_pose: u64,
    /// Mean distance of joints in space, mm; `None` where there is no body.
    pub joint_mm: Option<f64>,
    /// Mean distance of the root, mm.
    pub root_mm: Option<f64>,
    /// Mean distance of joints relative to the root, mm.
    pub local_mm: Option<f64>,
    /// RMS of every kind of channels, with its unit.
    pub kinds: Vec<(String, f64, String)>,
}

/// Size of a blob.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlobRecord {
    /// Its file, below the folder of the reproduction.
    pub file: String,
    /// All of it.
    pub bytes: usize,
    /// Bytes by part.
    pub parts: Vec<(String, u64)>,
    /// How it draws codes.
    pub sampler: String,
}

impl ReconstructionRecord {
    /// The figures of a reconstruction that belong into a report.
    pub fn new(reconstruction: &Reconstruction, macs_per_pose: u64) -> Self {
        let joints = reconstruction.joints;
        let kind = |error: &crate::reconstruct::GroupError| {
            (error.of.clone(), error.rms, error.unit.to_owned())
        };
        Self {
            macs_per_pose,
            joint_mm: joints.map(|joints| joints.joint_mm),
            root_mm: joints.map(|joints| joints.root_mm),
            local_mm: joints.map(|joints| joints.local_mm),
            kinds: reconstruction.kinds.iter().map(kind).collect(),
        }
    }
}

impl Outcome {
    /// What was done, if it was.
    pub const fn done(&self) -> Option<&JobRecord> {
        match self {
            Self::Done(record) => Some(record),
            Self::Failed(_) => None,
        }
    }
}
