//! Motions of the float model.
//!
//! In:  a checkpoint, and a [`CodeSampler`] over its sequence codes.
//! Out: what a classifier sees of its poses, to `evaluate`.

use rand::SeedableRng;
use rand::seq::IteratorRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{CodeSampler, MotionRequest, MotionSource, SourceDescription};
use crate::checkpoint::Checkpoint;
use crate::classifier::example::Input;
use crate::error::{Error, Result};
use crate::evaluate::real::PoseReader;
use crate::float_model::{Rows, Workspace};

/// Motions that go through the decoder together: enough to share the moments' half of layer 1.
const MOTIONS_PER_BATCH: usize = 64;

/// The clips' own codes, without noise: what the decoder can do when nothing is lost to the sampler. Not new motions.
///
/// Source: the "upper limit" of Cervantes et al., ECCV 2022.
pub struct ClipCodes<'a>(pub &'a Checkpoint);

impl CodeSampler for ClipCodes<'_> {
    fn name(&self) -> String {
        "the clips' own codes, replayed".to_owned()
    }

    fn sample(
        &self,
        action: usize,
        frame_count: usize,
        random: &mut ChaCha8Rng,
    ) -> Result<Vec<f32>> {
        let clips = self.0.dataset.clips.iter().enumerate();
        let fits =
            clips.filter(|(_, clip)| (clip.action, clip.frame_count) == (action, frame_count));
        let row = fits.map(|(row, _)| row).choose(random).ok_or_else(|| {
            let value = format!("{frame_count} frames");
            Error::bad_input(
                "run",
                "codes",
                value,
                "a length that a clip of the action has",
                "sample",
            )
        })?;
        Ok(self.0.sequence_codes.mean_of(row).to_vec())
    }
}

/// The float decoder with a sampler.
pub struct FloatSource<'a> {
    checkpoint: &'a Checkpoint,
    sampler: &'a dyn CodeSampler,
    reader: PoseReader,
    name: String,
    file_hash: String,
}

impl<'a> FloatSource<'a> {
    /// `name` and `file_hash` are for the report.
    ///
    /// # Errors
    /// A run whose weights are not finite.
    pub fn new(
        checkpoint: &'a Checkpoint,
        sampler: &'a dyn CodeSampler,
        name: impl Into<String>,
        file_hash: impl Into<String>,
    ) -> Result<Self> {
        let name = name.into();
        let mut weights = checkpoint
            .model
            .layers
            .iter()
            .flat_map(|layer| layer.weights.iter().chain(&layer.bias));
        if let Some(weight) = weights.find(|weight| !weight.is_finite()) {
            let remedy = "train again with smaller learning rates";
            return Err(Error::bad_input(name, "weights", weight, "finite numbers", remedy));
        }
        let dataset = &checkpoint.dataset;
        let reader = PoseReader::new(&dataset.layout, dataset.skeleton.as_ref());
        Ok(Self { checkpoint, sampler, reader, name, file_hash: file_hash.into() })
    }

    /// β by the sampler, then the action's mean α.
    fn code(&self, request: &MotionRequest) -> Result<Vec<f32>> {
        let mut random = ChaCha8Rng::seed_from_u64(request.seed);
        let mut code = self.sampler.sample(request.action, request.frame_count, &mut random)?;
        let expected = self.checkpoint.sequence_codes.dimension_count;
        if code.len() != expected {
            let remedy = "sample codes of this run";
            return Err(Error::bad_input(
                &self.name,
                "numbers of a code",
                code.len(),
                expected,
                remedy,
            ));
        }
        code.extend(self.checkpoint.action_codes.mean_of(request.action));
        Ok(code)
    }

    fn decode(&self, requests: &[MotionRequest], poses: &mut Vec<Vec<f32>>) -> Result<()> {
        let model = &self.checkpoint.model;
        let codes: Vec<Vec<f32>> =
            requests.iter().map(|request| self.code(request)).collect::<Result<_>>()?;
        let windows = requests.iter().map(|request| request.window);
        let frames = |window: super::Window| window.first..window.first + window.count;
        let mut moments: Vec<usize> = windows.clone().flat_map(frames).collect();
        moments.sort_unstable();
        moments.dedup();
        let mut tau = vec![0.0; moments.len() * model.sinusoid_count()];
        for (row, &frame) in tau.chunks_exact_mut(model.sinusoid_count().max(1)).zip(&moments) {
            model.embed_time(frame as f64, row);
        }
        let pairs = windows
            .enumerate()
            .flat_map(|(motion, window)| frames(window).map(move |frame| (motion, frame)));
        let (code_of_row, moment_of_row): (Vec<usize>, Vec<usize>) = pairs
            .map(|(motion, frame)| (motion, moments.partition_point(|&moment| moment < frame)))
            .unzip();
        let mut workspace = Workspace::new(model, requests.len(), moments.len(), code_of_row.len());
        let rows = Rows {
            codes: &codes.concat(),
            tau: &tau,
            code_of_row: &code_of_row,
            moment_of_row: &moment_of_row,
        };
        model.forward(&rows, &mut workspace);
        let mut outputs = workspace.outputs();
        for request in requests {
            poses.push(outputs.by_ref().take(request.window.count).flatten().copied().collect());
        }
        Ok(())
    }
}

impl MotionSource for FloatSource<'_> {
    fn description(&self) -> SourceDescription {
        SourceDescription {
            name: self.name.clone(),
            format: "float".to_owned(),
            sampler: self.sampler.name(),
            config_hash: self.checkpoint.state.config_hash.clone(),
            seed: self.checkpoint.state.seed,
            file_hash: self.file_hash.clone(),
            bytes: None,
        }
    }

    fn actions(&self) -> &[String] {
        &self.checkpoint.dataset.actions
    }

    fn input(&self) -> Input {
        self.reader.input()
    }

    fn channel_count(&self) -> usize {
        self.reader.channel_count()
    }

    fn rate_hz(&self) -> f64 {
        self.checkpoint.dataset.rate_hz
    }

    fn poses(&self, requests: &[MotionRequest]) -> Result<Vec<Vec<f32>>> {
        let mut poses = Vec::with_capacity(requests.len());
        for batch in requests.chunks(MOTIONS_PER_BATCH) {
            self.decode(batch, &mut poses)?;
        }
        let dataset = &self.checkpoint.dataset;
        poses.par_iter_mut().for_each(|motion| {
            dataset.destandardize(motion);
            let mut seen = Vec::with_capacity(motion.len());
            for pose in motion.chunks_exact(dataset.layout.channel_count()) {
                self.reader.read(pose, &mut seen);
            }
            *motion = seen;
        });
        Ok(poses)
    }
}
