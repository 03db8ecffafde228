//! Motions of a blob, in the device's own arithmetic.
//!
//! In:  a checked blob.
//! Out: what a classifier sees of its poses, to `evaluate`.
//!
//! Why here: `karakuri` samples and decodes, as on the device; nothing of its arithmetic is written a second time.

use std::path::Path;

use karakuri::{ActionId, Decoder, FramePosition, Model, Pcg32, Pose, Workspace};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::{MotionRequest, MotionSource, SourceDescription};
use crate::checkpoint::hexadecimal;
use crate::classifier::example::Input;
use crate::error::{Error, Result};
use crate::evaluate::real::PoseReader;
use crate::generate::{layout_of, skeleton_of};
use crate::inspect::blob::BlobReport;

/// A blob that makes motions.
pub struct BlobSource<'a> {
    model: &'a Model<'a>,
    reader: PoseReader,
    actions: Vec<String>,
    description: SourceDescription,
}

type Buffers = (Box<Workspace<{ karakuri::limits::WIDTH_MAX }>>, Pose);

impl<'a> BlobSource<'a> {
    /// `bytes` are those that `model` was read from, at `path`.
    ///
    /// # Errors
    /// A blob that core refuses.
    pub fn new(path: &Path, model: &'a Model<'a>, bytes: &[u8]) -> Result<Self> {
        let name = path.display().to_string();
        let layout = layout_of(model);
        let reader = PoseReader::new(&layout, skeleton_of(model).as_ref());
        let report = BlobReport::new(path, bytes)?;
        let description = SourceDescription {
            format: report.format.to_owned(),
            sampler: format!("{}, {} components", report.sampler, report.component_count),
            config_hash: report.config_hash,
            seed: report.seed,
            file_hash: hexadecimal(&Sha256::digest(bytes)),
            bytes: Some(bytes.len()),
            name,
        };
        let actions = model.actions().map(str::to_owned).collect();
        Ok(Self { model, reader, actions, description })
    }

    fn decode(&self, (workspace, pose): &mut Buffers, request: &MotionRequest) -> Result<Vec<f32>> {
        let mut random = Pcg32::new(request.seed);
        let action = ActionId(request.action as u16);
        let frame_count = request.frame_count as u32;
        let sampled = self.model.sample(action, frame_count, &mut || random.next_u32());
        let code = sampled.map_err(|reason| self.refusal(request, &reason.to_string()))?;
        let decoder = Decoder::new(self.model, &mut **workspace);
        let mut decoder = decoder.map_err(|reason| Error::Blob {
            path: self.description.name.clone().into(),
            reason: reason.to_string(),
        })?;
        decoder.start(&code);
        let mut seen = Vec::with_capacity(request.window.count * self.reader.channel_count());
        let mut channels = Vec::with_capacity(self.model.channel_count());
        let window = request.window.first..request.window.first + request.window.count;
        for frame in window {
            decoder.decode(FramePosition::from_frames(frame as u32), pose);
            channels.clear();
            channels.extend(pose.values().map(|value| value as f32));
            self.reader.read(&channels, &mut seen);
        }
        Ok(seen)
    }

    fn refusal(&self, request: &MotionRequest, reason: &str) -> Error {
        Error::bad_input(
            &self.description.name,
            format!("action `{}`, {} frames", self.actions[request.action], request.frame_count),
            reason,
            "lengths of the clips that the blob was made of",
            "give the clips of its training, with --run RUN if that held clips out",
        )
    }
}

impl MotionSource for BlobSource<'_> {
    fn description(&self) -> SourceDescription {
        self.description.clone()
    }

    fn actions(&self) -> &[String] {
        &self.actions
    }

    fn input(&self) -> Input {
        self.reader.input()
    }

    fn channel_count(&self) -> usize {
        self.reader.channel_count()
    }

    fn rate_hz(&self) -> f64 {
        f64::from(self.model.rate_millihz()) / 1000.0
    }

    fn poses(&self, requests: &[MotionRequest]) -> Result<Vec<Vec<f32>>> {
        let buffers = || (Box::new(Workspace::new()), Pose::new());
        requests
            .par_iter()
            .map_init(buffers, |buffers, request| self.decode(buffers, request))
            .collect()
    }
}
