//! Which rows are done, with which settings.
//!
//! In:  [`Experiments`], the budget and the names that the user asks for.
//! Out: one [`Job`] a training and its figures, to `stages`; a row that holds clips out is two jobs.
//!
//! Why here: a budget counted in passes over the clips is the same for every size of batch, one of steps is not; both
//! are settled here, before anything is trained, and mixtures stay out of a training's settings, so that rows that
//! differ in them alone share it.

use std::path::Path;

use crate::commands::sampler_args::SamplerArg;
use crate::config::TrainConfig;
use crate::error::{Error, Result};
use crate::reproduce::experiments::{Experiment, Experiments, PoseSource};
use crate::train::batch::StepPosition;

/// How long every training lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// As its preset says.
    Preset,
    /// So many forward and backward passes of a batch.
    Steps(u64),
    /// So many passes over all clips, whatever the size of a batch.
    Passes(u64),
}

/// One training and what is measured of it.
#[derive(Clone, Debug)]
pub struct Job {
    /// The row's name; that of its held-out twin ends in `-held-out`.
    pub name: String,
    /// Settings of the training; its mixture is the preset's.
    pub training: TrainConfig,
    /// The same with the row's mixture: what the row's artefacts name.
    pub config: TrainConfig,
    /// Where poses come from.
    pub sources: Vec<PoseSource>,
    /// How blobs draw codes.
    pub sampler: SamplerArg,
    /// Steps that the row would train for by its preset and its own keys.
    pub preset_steps: u64,
}

/// A row of the report and its jobs.
#[derive(Clone, Debug)]
pub struct PlannedRow {
    /// As the experiments have it.
    pub experiment: Experiment,
    /// Trained on all clips.
    pub job: Job,
    /// Trained on the clips that are not held out.
    pub held_out: Option<Job>,
}

/// The rows to do, in the file's order; `only` empty means all.
///
/// # Errors
/// `BadInput` when `only` names a row that does not exist, or a setting is out of range.
pub fn plan(
    experiments: &Experiments,
    only: &[String],
    budget: Budget,
    source: &Path,
) -> Result<Vec<PlannedRow>> {
    let names: Vec<&str> = experiments.rows.iter().map(|row| row.name.as_str()).collect();
    if let Some(unknown) = only.iter().find(|name| !names.contains(&name.as_str())) {
        let remedy = "choose among these rows";
        return Err(Error::bad_input("--only", "row", unknown, names.join(", "), remedy));
    }
    let wanted = experiments.rows.iter().filter(|row| only.is_empty() || only.contains(&row.name));
    wanted.map(|row| planned(row, budget, source)).collect()
}

fn planned(experiment: &Experiment, budget: Budget, source: &Path) -> Result<PlannedRow> {
    let mut config = experiment.train_config(source)?;
    let preset_steps = config.budget.steps;
    if let Budget::Steps(steps) = budget {
        (config.budget.steps, config.budget.minutes) = (steps, 0.0);
    }
    let job = Job {
        name: experiment.name.clone(),
        training: TrainConfig {
            mixture: TrainConfig::preset(&experiment.preset)?.mixture,
            ..config.clone()
        },
        config,
        sources: experiment.sources(source)?,
        sampler: experiment.sampler(source)?,
        preset_steps,
    };
    let held_out = experiment.hold_out.map(|share| {
        let mut twin = job.clone();
        twin.name.push_str("-held-out");
        (twin.training.hold_out, twin.config.hold_out) = (share, share);
        // Formats differ from one another as they do on all clips; the chip's own needs one blob.
        let mut blobs = 0;
        twin.sources.retain(|source| {
            blobs += usize::from(*source != PoseSource::Float);
            *source == PoseSource::Float || blobs == 1
        });
        twin
    });
    Ok(PlannedRow { experiment: experiment.clone(), job, held_out })
}

impl Budget {
    /// Writes the budget into a training's settings, now that the number of its clips is known.
    pub fn settle(self, config: &mut TrainConfig, clip_count: usize) {
        if let Self::Passes(passes) = self {
            let batch_count = StepPosition::batch_count(clip_count, config) as u64;
            (config.budget.steps, config.budget.minutes) = (passes * batch_count, 0.0);
        }
    }

    /// In words, for the report.
    pub fn in_words(self) -> String {
        match self {
            Self::Preset => "as each preset says".into(),
            Self::Steps(steps) => format!("{steps} steps for every training"),
            Self::Passes(passes) => format!("{passes} passes over the clips for every training"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(only: &[&str], budget: Budget) -> Result<Vec<PlannedRow>> {
        let experiments = Experiments::built_in("humanact12").unwrap();
        let only: Vec<String> = only.iter().map(|name| (*name).to_owned()).collect();
        plan(&experiments, &only, budget, Path::new("humanact12"))
    }

    #[test]
    fn unknown_row_is_refused_with_the_known_ones() {
        let error = rows(&["paper", "papre"], Budget::Preset).unwrap_err().to_string();
        assert!(error.contains("papre") && error.contains("non-variational"), "{error}");
    }

    #[test]
    fn rows_that_differ_in_the_mixture_alone_share_a_training() {
        let rows = rows(&["paper", "mixture-1"], Budget::Steps(9)).unwrap();
        assert_eq!(rows[0].job.training, rows[1].job.training);
        assert_ne!(rows[0].job.config, rows[1].job.config);
        assert_eq!(rows[1].job.training.budget.steps, 9);
    }

    #[test]
    fn row_that_holds_clips_out_has_a_twin() {
        let rows = rows(&["paper"], Budget::Preset).unwrap();
        let twin = rows[0].held_out.as_ref().unwrap();
        assert_eq!((twin.name.as_str(), twin.training.hold_out), ("paper-held-out", 0.2));
        assert_eq!(rows[0].job.training.hold_out, 0.0);
    }

    #[test]
    fn budget_in_passes_gives_every_batch_size_the_same_poses() {
        let config = |name: &str| {
            let mut config = TrainConfig::preset(name).unwrap();
            Budget::Passes(10).settle(&mut config, 1190);
            config.budget.steps
        };
        assert_eq!([config("paper"), config("published"), config("small")], [380, 30, 30]);
    }
}
