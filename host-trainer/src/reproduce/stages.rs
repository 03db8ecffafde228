//! The stages of one job: train → mixture → quantize → reconstruct → evaluate.
//!
//! In:  a [`Job`] and the clips.
//! Out: [`JobRecord`]; in the folder of the reproduction `trainings/<hash>/` (a run), and in that of the row
//! `mixture.safetensors`, `<format>-<hash>.kara` and the figures of each.
//!
//! Why here: every stage asks the disk first. The key of a stage holds that of the stage before it, and a training's
//! key stands for its checkpoint, which is the same bytes whenever and wherever it is made. So a checkpoint is loaded
//! only when something has to be made of it.

mod source;

use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::checkpoint::{Checkpoint, hexadecimal};
use crate::commands::clips::SplitClips;
use crate::config::TrainConfig;
use crate::error::{Error, Result};
use crate::mixture;
use crate::mixture::set::MixtureSet;
use crate::reproduce::cache::{self, Key};
use crate::reproduce::clips::Clips;
use crate::reproduce::measure::Measure;
use crate::reproduce::plan::{Budget, Job};
use crate::reproduce::record::{JobRecord, TrainingRecord};
use crate::train::batch::StepPosition;
use crate::train::metrics::MetricLine;
use crate::train::{Progress, Start, TrainOptions, train};

/// What all jobs share.
#[derive(Clone, Copy)]
pub struct Workshop<'a> {
    /// Folder of the reproduction.
    pub out: &'a Path,
    /// Length of every training.
    pub budget: Budget,
    /// Threads; `None`: one per core.
    pub thread_count: Option<usize>,
    /// Set from outside to stop at the next step or stage.
    pub stop: &'a AtomicBool,
    /// The command that goes on.
    pub resume_command: &'a str,
    /// Whether progress is drawn.
    pub progress: Progress,
    /// How generated motions are measured; `None`: they are not.
    pub measure: Option<&'a Measure>,
}

/// One job at work.
pub struct Work<'a> {
    workshop: Workshop<'a>,
    job: &'a Job,
    clips: &'a mut Clips,
    /// Names the training and so its checkpoint.
    key: Key,
    /// Folder of the row.
    folder: PathBuf,
    checkpoint: Option<Rc<Checkpoint>>,
    mixtures: Option<Rc<MixtureSet>>,
}

impl<'a> Work<'a> {
    /// Before the first stage.
    pub fn new(workshop: Workshop<'a>, job: &'a Job, clips: &'a mut Clips) -> Self {
        let key = training_key(&workshop, job, clips);
        let folder = workshop.out.join(&job.name);
        Self { workshop, job, clips, key, folder, checkpoint: None, mixtures: None }
    }

    /// All stages that are not done yet.
    ///
    /// # Errors
    /// Those of every stage; `Interrupted` when the user asked to stop.
    pub fn finish(mut self) -> Result<JobRecord> {
        cache::folder(&self.folder)?;
        let training = self.training()?;
        let sources =
            self.job.sources.iter().map(|source| self.source(*source)).collect::<Result<_>>()?;
        Ok(JobRecord { training, sources })
    }

    fn training(&mut self) -> Result<TrainingRecord> {
        self.check_stop()?;
        let file = self.folder.join(format!("train-{}.json", self.key.digits()));
        cache::value(&file, || {
            let checkpoint = self.checkpoint()?;
            let config = &checkpoint.config;
            let clip_count = checkpoint.dataset.clips.len();
            let batch_count = StepPosition::batch_count(clip_count, config);
            Ok(TrainingRecord {
                config_hash: hexadecimal(&config.config_hash()),
                seed: config.seed,
                steps: checkpoint.state.step,
                preset_steps: self.job.preset_steps,
                passes: checkpoint.state.step as f64 / batch_count as f64,
                seconds: training_seconds(&self.run_folder())?,
                clip_count,
                held_out_count: checkpoint.dataset.held_out.len(),
                parameter_count: checkpoint.model.parameter_count(),
            })
        })
    }

    fn run_folder(&self) -> PathBuf {
        self.workshop.out.join("trainings").join(self.key.digits())
    }

    /// Trained to the end, now or before.
    fn checkpoint(&mut self) -> Result<Rc<Checkpoint>> {
        if let Some(checkpoint) = &self.checkpoint {
            return Ok(Rc::clone(checkpoint));
        }
        let split = self.clips.of(&self.job.training)?;
        let mut config = self.job.training.clone();
        self.workshop.budget.settle(&mut config, split.training.dataset.description.clips.len());
        let mut checkpoint = self.train(&split, &config)?;
        // What is made of it follows the row's mixture, and names it.
        checkpoint.config.mixture = self.job.config.mixture.clone();
        Ok(Rc::clone(self.checkpoint.insert(Rc::new(checkpoint))))
    }

    fn train(&self, split: &SplitClips, config: &TrainConfig) -> Result<Checkpoint> {
        let run = self.run_folder();
        let start = match run.join(Checkpoint::FILE_NAME).exists() {
            true => Start::Resume,
            false => Start::New,
        };
        if start == Start::Resume {
            let checkpoint = Checkpoint::load(&run)?;
            if checkpoint.state.finished {
                return Ok(checkpoint);
            }
        }
        cache::folder(&self.workshop.out.join("trainings"))?;
        self.say(&format!("train, {} steps", config.budget.steps));
        let options = TrainOptions {
            start,
            thread_count: self.workshop.thread_count,
            stop: self.workshop.stop,
            resume_command: self.workshop.resume_command,
            progress: self.workshop.progress,
        };
        train(&split.training.dataset, config, &run, &options)
    }

    fn mixtures(&mut self) -> Result<Rc<MixtureSet>> {
        if let Some(mixtures) = &self.mixtures {
            return Ok(Rc::clone(mixtures));
        }
        let checkpoint = self.checkpoint()?;
        self.check_stop()?;
        self.say("mixture");
        let mixtures = mixture::file::of_checkpoint(&self.folder, &checkpoint)?;
        Ok(Rc::clone(self.mixtures.insert(Rc::new(mixtures))))
    }

    fn say(&self, stage: &str) {
        if self.workshop.progress == Progress::Bar {
            eprintln!("{}: {stage}", self.job.name);
        }
    }

    fn check_stop(&self) -> Result<()> {
        match self.workshop.stop.load(Ordering::Relaxed) {
            false => Ok(()),
            true => Err(Error::Interrupted { resume: self.workshop.resume_command.to_owned() }),
        }
    }
}

/// Names a training, and so the checkpoint that it ends in.
pub fn training_key(workshop: &Workshop<'_>, job: &Job, clips: &Clips) -> Key {
    Key::new("train")
        .with(&clips.fingerprint)
        .with(job.training.to_toml())
        .with(format!("{:?}", workshop.budget))
}

/// Whether the training of this key has ended.
pub fn is_trained(workshop: &Workshop<'_>, key: &Key) -> bool {
    let run = workshop.out.join("trainings").join(key.digits());
    Checkpoint::load(&run).is_ok_and(|checkpoint| checkpoint.state.finished)
}

/// Wall time of all steps of a run, over all its interruptions, by its own history.
fn training_seconds(run: &Path) -> Result<f64> {
    let file = run.join(crate::train::metrics::MetricLog::FILE_NAME);
    let text = fs::read_to_string(&file).map_err(Error::io("read", &file))?;
    let lines = text.lines().filter_map(|line| serde_json::from_str::<MetricLine>(line).ok());
    let mut step = 0;
    Ok(lines
        .map(|line| {
            let steps = line.step.saturating_sub(step);
            step = line.step;
            if line.steps_per_s > 0.0 { steps as f64 / line.steps_per_s } else { 0.0 }
        })
        .sum())
}
