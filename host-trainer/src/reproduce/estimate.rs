//! How long the trainings that are still to do will take on this machine.
//!
//! In:  the plan, the clips.
//! Out: seconds, for the line that is printed before anything starts.
//!
//! Why here: the presets' own budgets take hours. Some steps of the first training are timed, and the others are taken
//! to cost as much per weight and row of a batch. Mixtures and measurements come on top.

use std::collections::HashSet;
use std::time::Instant;

use crate::checkpoint::Checkpoint;
use crate::config::TrainConfig;
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::reproduce::clips::Clips;
use crate::reproduce::plan::{Job, PlannedRow};
use crate::reproduce::stages::{Workshop, is_trained, training_key};
use crate::train::batch::StepPosition;
use crate::train::step::Trainer;

/// What is still to be trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingEstimate {
    /// Trainings that are not finished.
    pub training_count: usize,
    /// Their steps.
    pub steps: u64,
    /// What they will take.
    pub seconds: f64,
}

/// Times some steps of the first unfinished training and scales by work; a row whose clips cannot be prepared counts
/// nothing here and is reported when its turn comes.
///
/// # Errors
/// `Io` when threads cannot be started.
pub fn estimate(
    rows: &[PlannedRow],
    clips: &mut Clips,
    workshop: &Workshop<'_>,
) -> Result<TrainingEstimate> {
    let mut estimate = TrainingEstimate { training_count: 0, steps: 0, seconds: 0.0 };
    let (mut seen, mut seconds_per_work) = (HashSet::new(), None);
    for job in rows.iter().flat_map(|row| [Some(&row.job), row.held_out.as_ref()]).flatten() {
        let key = training_key(workshop, job, clips);
        if !seen.insert(key.digits()) || is_trained(workshop, &key) {
            continue;
        }
        let Ok(split) = clips.of(&job.training) else { continue };
        let dataset = &split.training.dataset;
        let config = settled(job, dataset, workshop);
        let per_work = match seconds_per_work {
            Some(seconds) => seconds,
            None => *seconds_per_work.insert(time_steps(dataset, &config, workshop)?),
        };
        estimate.training_count += 1;
        estimate.steps += config.budget.steps;
        estimate.seconds += per_work * config.budget.steps as f64 * step_work(dataset, &config);
    }
    Ok(estimate)
}

fn settled(job: &Job, dataset: &Dataset, workshop: &Workshop<'_>) -> TrainConfig {
    let mut config = job.training.clone();
    workshop.budget.settle(&mut config, dataset.description.clips.len());
    config
}

/// Weights times rows of a step.
fn step_work(dataset: &Dataset, config: &TrainConfig) -> f64 {
    let channel_count = dataset.description.layout.channel_count();
    let codes = &config.codes;
    let input_count =
        codes.sequence_dimensions + codes.action_dimensions + config.time.sinusoid_count;
    let widths = [&[input_count], &config.decoder.hidden_widths[..], &[channel_count]].concat();
    let weights: usize = widths.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let clip_count = StepPosition::clips_max(dataset.description.clips.len(), config);
    (weights * clip_count * config.batch.frames) as f64
}

/// Seconds per weight and row.
fn time_steps(dataset: &Dataset, config: &TrainConfig, workshop: &Workshop<'_>) -> Result<f64> {
    const WARM_UP_STEPS: u32 = 2;
    const STEPS: u32 = 6;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(workshop.thread_count.unwrap_or(0));
    let pool = threads.build().map_err(|error| {
        Error::io("start threads for", workshop.out)(std::io::Error::other(error))
    })?;
    let seconds = pool.install(|| {
        let mut trainer = Trainer::new(Checkpoint::start(dataset, config), dataset);
        (0..WARM_UP_STEPS).for_each(|_| trainer.step(1.0));
        let started = Instant::now();
        (0..STEPS).for_each(|_| trainer.step(1.0));
        started.elapsed().as_secs_f64() / f64::from(STEPS)
    });
    Ok(seconds / step_work(dataset, config))
}
