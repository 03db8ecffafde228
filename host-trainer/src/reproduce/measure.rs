//! The stage `evaluate` of one source of poses: the papers' figures of its generated motions.
//!
//! In:  a classifier, the protocol of the experiments; a run's clips, checkpoint and mixtures, or its blob.
//! Out: the whole of `host-trainer evaluate --json`, of which a report shows an [`EvaluationRecord`].
//!
//! Why here: figures come from `evaluate` alone; this file says which protocol the experiments want, and what names a
//! measurement in its key.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::checkpoint::hexadecimal;
use crate::classifier::Classifier;
use crate::error::{Error, Result};
use crate::evaluate::evaluate;
use crate::evaluate::judge::Judge;
use crate::evaluate::protocol::{ActionShares, Protocol, Start};
use crate::evaluate::real::RealMotions;
use crate::evaluate::report::ClassifierDescription;
use crate::evaluate::source::MotionSource;
use crate::reproduce::experiments::{Experiments, HiddenStart, Shares};
use crate::reproduce::record::EvaluationRecord;
use crate::train::Progress;

/// What all measurements share.
pub struct Measure {
    classifier: Classifier,
    description: ClassifierDescription,
    /// Names of the classifier's actions, where it does not know them.
    order: Option<Vec<String>>,
    protocol: Protocol,
}

impl Measure {
    /// Reads the classifier.
    ///
    /// # Errors
    /// Those of reading it.
    pub fn open(
        file: &Path,
        order: Option<Vec<String>>,
        experiments: &Experiments,
        repetitions: usize,
    ) -> Result<Self> {
        let classifier = Classifier::load(file)?;
        let bytes = std::fs::read(file).map_err(Error::io("read", file))?;
        let description = ClassifierDescription {
            file: file.display().to_string(),
            sha256: hexadecimal(&Sha256::digest(bytes)),
        };
        let protocol = Protocol {
            repetitions,
            frames: experiments.frames,
            start: match experiments.start {
                HiddenStart::Zeros => Start::Zeros,
                HiddenStart::Gaussian => Start::Gaussian,
            },
            actions: match experiments.actions {
                Shares::Frequencies => ActionShares::Data,
                Shares::Uniform { motions_per_action } => {
                    ActionShares::Uniform { motions_per_action }
                }
            },
            ..Protocol::default()
        };
        Ok(Self { classifier, description, order, protocol })
    }

    /// Everything but the motions that a measurement depends on.
    pub fn fingerprint(&self) -> String {
        format!("{} {:?} {:?}", self.description.sha256, self.order, self.protocol)
    }

    /// Repetitions of every measurement.
    pub const fn repetitions(&self) -> usize {
        self.protocol.repetitions
    }

    /// Measures a source of motions.
    ///
    /// # Errors
    /// Those of [`Judge::new`] and [`evaluate`].
    pub fn evaluate(
        &self,
        source: &dyn MotionSource,
        data: &RealMotions,
        progress: Progress,
    ) -> Result<serde_json::Value> {
        let order = self.order.as_deref();
        let judge = Judge::new(&self.classifier, self.description.clone(), data, order)?;
        let evaluation = evaluate(source, data, &judge, &self.protocol, progress)?;
        serde_json::to_value(evaluation)
            .map_err(|error| Error::io("write", "evaluation")(std::io::Error::other(error)))
    }
}

/// The figures that a report shows.
///
/// # Errors
/// `BadInput` when the file holds no evaluation.
pub fn figures(evaluation: serde_json::Value, file: &Path) -> Result<EvaluationRecord> {
    serde_json::from_value(evaluation).map_err(|error| {
        let remedy = "delete the file; it is made again";
        Error::bad_input(file, "the evaluation", error, "figures with mean and ci95", remedy)
    })
}
