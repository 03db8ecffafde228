//! The stages of one source of poses: quantize, reconstruct, evaluate.
//!
//! In:  a job's checkpoint and mixtures, when something has to be made of them.
//! Out: [`SourceRecord`]; in the row's folder `<format>-<hash>.kara` and the figures of each source.

use std::path::Path;

use karakuri::NumberFormat;

use super::Work;
use crate::checkpoint::Checkpoint;
use crate::commands::quantize::quantize_checkpoint;
use crate::commands::sampler_args::ClipArgs;
use crate::error::Result;
use crate::evaluate::source::{BlobSource, FloatSource};
use crate::float_model::DenseLayer;
use crate::inspect::blob::{BlobReport, load};
use crate::quantize::QuantizeOptions;
use crate::reconstruct::{Source, reconstruct};
use crate::reproduce::cache::{self, Key};
use crate::reproduce::experiments::PoseSource;
use crate::reproduce::measure::figures;
use crate::reproduce::record::{BlobRecord, EvaluationRecord, ReconstructionRecord, SourceRecord};

/// Every how many frames a reconstruction is compared: neighbours say nearly the same.
const STRIDE: usize = 5;

impl Work<'_> {
    pub(super) fn source(&mut self, source: PoseSource) -> Result<SourceRecord> {
        self.check_stop()?;
        let key = self.key.clone().with(self.job.config.to_toml()).with(source.name());
        let PoseSource::Blob(format) = source else {
            let reconstruction = self.reconstruction(source, &key, None)?;
            return Ok(SourceRecord {
                source: source.name().into(),
                macs_per_pose: reconstruction.macs_per_pose,
                reconstruction,
                blob: None,
                evaluation: self.evaluation(source, &key, None)?,
            });
        };
        let key = key.with(format!("{:?}", self.job.sampler));
        let file = format!("{}-{}.kara", format.name(), key.digits());
        let path = self.folder.join(&file);
        let blob = cache::bytes(&path, || self.quantized(format))?;
        let reconstruction = self.reconstruction(source, &key, Some((&path, &blob)))?;
        let report = BlobReport::new(&path, &blob)?;
        Ok(SourceRecord {
            source: source.name().into(),
            macs_per_pose: reconstruction.macs_per_pose,
            reconstruction,
            blob: Some(BlobRecord::new(&report, format!("{}/{file}", self.job.name))),
            evaluation: self.evaluation(source, &key, Some((&path, &blob)))?,
        })
    }

    fn quantized(&mut self, format: NumberFormat) -> Result<Vec<u8>> {
        let options = QuantizeOptions {
            sampler: self.job.sampler.choice(&ClipArgs::default()),
            ..QuantizeOptions::new(format)
        };
        let (checkpoint, mixtures) = (self.checkpoint()?, self.mixtures()?);
        self.say(&format!("quantize {}", format.name()));
        Ok(quantize_checkpoint(&self.job.name, &checkpoint, &mixtures, &options)?.blob)
    }

    fn reconstruction(
        &mut self,
        source: PoseSource,
        key: &Key,
        blob: Option<(&Path, &[u8])>,
    ) -> Result<ReconstructionRecord> {
        let file = format!("reconstruct-{}-{}.json", source.name(), key.digits());
        cache::value(&self.folder.join(file), || {
            let checkpoint = self.checkpoint()?;
            let split = self.clips.of(&self.job.training)?;
            self.say(&format!("reconstruct {}", source.name()));
            let (dataset, bones) = (&split.training.dataset, &split.training.bones);
            let model = blob.map(|(path, blob)| load(path, blob)).transpose()?;
            let (source, macs) = match &model {
                Some(model) => (Source::Blob(model), model.multiply_accumulates_per_pose()),
                None => (Source::Float, float_macs_per_pose(&checkpoint)),
            };
            let found = reconstruct(&checkpoint, source, dataset, bones, STRIDE);
            Ok(ReconstructionRecord::new(&found, macs))
        })
    }

    fn evaluation(
        &mut self,
        source: PoseSource,
        key: &Key,
        blob: Option<(&Path, &[u8])>,
    ) -> Result<Option<EvaluationRecord>> {
        let Some(measure) = self.workshop.measure else {
            return Ok(None);
        };
        self.check_stop()?;
        let key = key.clone().with(measure.fingerprint());
        let file = format!("evaluate-{}-{}.json", source.name(), key.digits());
        let file = self.folder.join(file);
        let evaluation = cache::value(&file, || {
            let real = self.clips.real(&self.job.training)?;
            let progress = self.workshop.progress;
            if let Some((path, blob)) = blob {
                self.say(&format!("evaluate {}", source.name()));
                let model = load(path, blob)?;
                return measure.evaluate(&BlobSource::new(path, &model, blob)?, &real, progress);
            }
            let (checkpoint, mixtures) = (self.checkpoint()?, self.mixtures()?);
            self.say("evaluate float");
            let (name, hash) = (self.job.name.clone(), self.key.digits());
            let float = FloatSource::new(&checkpoint, &*mixtures, name, hash)?;
            measure.evaluate(&float, &real, progress)
        })?;
        figures(evaluation, &file).map(Some)
    }
}

/// As core counts: what the code contributes to layer 1 is computed once a motion.
fn float_macs_per_pose(checkpoint: &Checkpoint) -> u64 {
    let model = &checkpoint.model;
    let products = |layer: &DenseLayer| layer.input_count * layer.output_count;
    let all: usize = model.layers.iter().map(products).sum();
    let code_count = model.layers[0].input_count - 2 * model.frequencies_rad.len();
    (all - code_count * model.layers[0].output_count) as u64
}

impl BlobRecord {
    /// The figures of a blob that belong into a report.
    fn new(report: &BlobReport, file: String) -> Self {
        Self {
            file,
            bytes: report.bytes,
            parts: report.parts.iter().map(|part| (part.part.to_owned(), part.bytes)).collect(),
            sampler: report.sampler.to_owned(),
        }
    }
}
