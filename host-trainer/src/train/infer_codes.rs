//! The code of a clip that training did not see: what it takes to say how well a decoder generalises.
//!
//! In:  a trained [`Checkpoint`]; a [`Dataset`] of held-out clips.
//! Out: the checkpoint with one code a held-out clip in place of the training clips' codes, to `reconstruct`.
//!
//! Why here: there is no encoder to ask. So β is learned as in training, by the same step on the same loss with the
//! same noise and KL, while decoder and α stay as they are. What then remains is what the decoder cannot express.
//!
//! Source: Park et al., CVPR 2019 (DeepSDF), section 4.2: an unseen shape's code is the minimum of the loss over codes.

use super::batch::StepPosition;
use super::step::Trainer;
use super::{BAR_LENGTH, Progress, progress_bar, schedule::rate_factor};
use crate::checkpoint::Checkpoint;
use crate::config::ScheduleShape;
use crate::dataset::{Dataset, DatasetDescription};
use crate::float_model::CodeTable;
use crate::train::optimizer::CodeMoments;

/// Passes over the held-out clips.
pub const PASS_COUNT: u64 = 2000;
/// Learning rate at the start; it falls to 0 along a cosine. Codes are of order 1 in every preset, so one rate fits.
///
/// Measured on Reachy Mini with preset `small`: for training clips the codes so found, from the mean of their action,
/// end within 1 % of the error that training reached; at the training's own rate 3000 passes still left 15 %.
const LEARNING_RATE: f64 = 0.1;

/// Finds the codes of held-out clips; each starts at the mean of its action's codes.
///
/// The same checkpoint and clips give the same codes, with any number of threads.
pub fn infer_codes(checkpoint: &Checkpoint, held_out: &Dataset, progress: Progress) -> Checkpoint {
    let clip_count = held_out.description.clips.len();
    let batch_count = StepPosition::batch_count(clip_count, &checkpoint.config);
    let step_count = PASS_COUNT * batch_count as u64;
    let bar = progress_bar(progress);
    bar.set_message(format!("codes of {clip_count} held-out clips"));
    let start = at_action_means(checkpoint, &held_out.description);
    let mut trainer = Trainer::new(start, held_out);
    for step in 0..step_count {
        let done = step as f64 / step_count as f64;
        trainer.step_sequence_codes(rate_factor(ScheduleShape::Cosine, done));
        bar.set_position((done * BAR_LENGTH as f64) as u64);
    }
    bar.finish_and_clear();
    trainer.checkpoint
}

/// The checkpoint before its first step on other clips of the same actions.
fn at_action_means(checkpoint: &Checkpoint, held_out: &DatasetDescription) -> Checkpoint {
    let means = action_means(&checkpoint.sequence_codes, &checkpoint.dataset);
    let actions = || held_out.clips.iter().map(|clip| clip.action);
    let mut start = checkpoint.clone();
    start.sequence_codes = CodeTable {
        dimension_count: means.dimension_count,
        mean: actions().flat_map(|action| means.mean_of(action)).copied().collect(),
        log_variance: actions().flat_map(|action| means.log_variance_of(action)).copied().collect(),
    };
    start.optimizer.sequence_codes = CodeMoments::zeros(&start.sequence_codes);
    start.dataset = held_out.clone();
    start.state.step = 0;
    start.config.adam.code_learning_rate = LEARNING_RATE;
    start
}

/// Mean and log-variance of every action's codes, each averaged over the action's clips. // row: action
fn action_means(codes: &CodeTable, dataset: &DatasetDescription) -> CodeTable {
    let mut clip_counts = vec![0.0; dataset.actions.len()];
    dataset.clips.iter().for_each(|clip| clip_counts[clip.action] += 1.0);
    let mut means = CodeTable::constant(dataset.actions.len(), codes.dimension_count, 0.0);
    for (row, clip) in dataset.clips.iter().enumerate() {
        let start = clip.action * codes.dimension_count;
        let weight = 1.0 / clip_counts[clip.action];
        for dimension in 0..codes.dimension_count {
            means.mean[start + dimension] += weight * codes.mean_of(row)[dimension];
            means.log_variance[start + dimension] += weight * codes.log_variance_of(row)[dimension];
        }
    }
    means
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::reconstruct::{Source, reconstruct};
    use crate::train::synthetic::{config, dataset};

    /// A decoder that has learned its clips, and those clips.
    fn trained() -> (Checkpoint, Dataset) {
        let (dataset, config) = (dataset(), config("[adam]\ndecoder_learning_rate = 0.01"));
        let mut trainer = Trainer::new(Checkpoint::start(&dataset, &config), &dataset);
        (0..2000).for_each(|_| trainer.step(1.0));
        (trainer.checkpoint, dataset)
    }

    fn error(checkpoint: &Checkpoint, dataset: &Dataset) -> f64 {
        let reconstruction = reconstruct(checkpoint, Source::Float, dataset, &[], 1);
        reconstruction.kinds.iter().map(|kind| kind.rms).sum()
    }

    #[test]
    fn codes_of_forgotten_clips_are_found_again_and_nothing_else_moves() {
        let (checkpoint, dataset) = trained();
        let start = at_action_means(&checkpoint, &dataset.description);
        let found = infer_codes(&checkpoint, &dataset, Progress::Hidden);
        let learned = error(&checkpoint, &dataset);
        let (before, after) = (error(&start, &dataset), error(&found, &dataset));
        assert!(after < 0.5 * before, "{before} → {after}; learned {learned}");
        assert!(after < 1.5 * learned, "{before} → {after}; learned {learned}");
        assert_eq!(found.model, checkpoint.model);
        assert_eq!(found.action_codes, checkpoint.action_codes);
        assert_eq!(found.optimizer.decoder, checkpoint.optimizer.decoder);
        assert_eq!(found.optimizer.action_codes, checkpoint.optimizer.action_codes);
    }

    #[test]
    fn number_of_threads_does_not_change_the_codes() {
        let (checkpoint, dataset) = trained();
        let with_threads = |count| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
            pool.install(|| infer_codes(&checkpoint, &dataset, Progress::Hidden).sequence_codes)
        };
        assert_eq!(with_threads(1), with_threads(2));
    }

    #[test]
    fn start_is_the_mean_of_the_actions_codes() {
        let (dataset, config) = (dataset(), config(""));
        let mut checkpoint = Checkpoint::start(&dataset, &config);
        // Clips 0, 2 and 4 are of action 0, clips 1 and 3 of action 1.
        for (index, mean) in checkpoint.sequence_codes.mean.iter_mut().enumerate() {
            *mean = (index / 4) as f32;
        }
        let start = at_action_means(&checkpoint, &dataset.description).sequence_codes;
        let near = |row, value: f32| start.mean_of(row).iter().all(|m| (m - value).abs() < 1e-6);
        assert!(near(0, 2.0) && near(1, 2.0) && near(3, 2.0), "{:?}", start.mean);
        checkpoint.sequence_codes.mean[4..8].fill(5.0);
        let start = at_action_means(&checkpoint, &dataset.description).sequence_codes;
        assert_eq!((start.mean_of(0), start.mean_of(1)), (start.mean_of(4), start.mean_of(3)));
        assert!(start.mean_of(1).iter().all(|mean| (mean - 4.0).abs() < 1e-6));
    }
}
