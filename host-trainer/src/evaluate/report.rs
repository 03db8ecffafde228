//! What a measurement found, with everything that it depends on.
//!
//! In:  the scores of all repetitions.
//! Out: [`Evaluation`], as JSON for programs and by `text` and `picture` for people.

use serde::Serialize;

use crate::classifier::example::Input;

use super::estimate::Estimate;
use super::nearest_clip::Quantiles;
use super::papers::PaperRow;
use super::physical::figures::PhysicalFigures;
use super::protocol::Protocol;
use super::source::SourceDescription;

/// The figures of generated motions beside those of real ones.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Where the motions come from.
    pub source: SourceDescription,
    /// What they were measured with.
    pub classifier: ClassifierDescription,
    /// What they were measured against.
    pub data: DataDescription,
    /// How.
    pub protocol: Protocol,
    /// Of generated motions.
    #[serde(flatten)]
    pub generated: Figures,
    /// Of real motions: the training clips again, in other windows.
    pub real: Figures,
    /// How far motions are from the training clip that they are most like; see `nearest_clip`.
    pub nearest_training_clip_mm: NearestTrainingClip,
    /// Published rows of the same measurement; empty where there are none, see the remarks.
    pub papers: Vec<PaperRow>,
    /// What a reader has to know about these figures, in sentences.
    pub remarks: Vec<String>,
}

/// One row of the papers' tables, and more.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Fréchet distance of the features to those of the training clips.
    pub fid: Estimate,
    /// The same to the held-out clips; `None` where nothing comparable was held out, see the remarks.
    pub fid_held_out: Option<Estimate>,
    /// Share of the motions that the classifier takes for their action.
    pub accuracy: Estimate,
    /// Mean distance of features, over pairs of all motions.
    pub diversity: Estimate,
    /// The same within an action, mean over the actions.
    pub multimodality: Estimate,
    /// Mean distance of features to the nearest training clip.
    pub mms: Estimate,
    /// Average pairwise distance of crops within an action, metres (or channel units), mean over the
    /// actions.
    pub apd: Estimate,
    /// The same as a share of the training clips', per action, mean over the actions, percent.
    pub apd_normalized: Estimate,
    /// Figures in metres and seconds, without the classifier; `None` for what is no body.
    pub physical: Option<PhysicalFigures>,
    /// Accuracy of each action's motions, in the order of the data's actions.
    pub accuracy_by_action: Vec<ActionAccuracy>,
}

/// Distances to the nearest training clip over all repetitions, millimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NearestTrainingClip {
    /// Of generated motions.
    pub generated: Option<Quantiles>,
    /// Of held-out clips: what an honest motion looks like. `None` where nothing was held out.
    pub held_out: Option<Quantiles>,
    /// Of training clips to the nearest of the others.
    pub training: Option<Quantiles>,
}

/// Accuracy of one action.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActionAccuracy {
    /// Its name.
    pub action: String,
    /// Motions of it in one repetition.
    pub motion_count: usize,
    /// Share of them that the classifier takes for it.
    #[serde(flatten)]
    pub accuracy: Estimate,
}

/// A classifier, for the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClassifierDescription {
    /// Its file.
    pub file: String,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
}

/// A set of clips, for the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DataDescription {
    /// Clips that generated motions are compared with.
    pub training_clip_count: usize,
    /// Clips that training did not see.
    pub held_out_clip_count: usize,
    /// Names of the actions.
    pub actions: Vec<String>,
    /// What a pose is.
    pub input: Input,
    /// Joints or channels of a pose.
    pub joint_count: usize,
    /// Poses per second.
    pub rate_hz: f64,
}
