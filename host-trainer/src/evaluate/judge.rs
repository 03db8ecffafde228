//! A classifier that is known to fit the data: what scores crops, and in whose order the actions stand.
//!
//! In:  a classifier, the data, and where the classifier names no actions the order that the user gives.
//! Out: [`Judge`]; or the reason why any figure would be wrong.
//!
//! Why here: a classifier that was trained on other joints or actions gives figures too, and nothing in them looks
//! wrong. So what does not fit is refused before anything is measured.

use crate::classifier::{Classifier, HiddenStart};
use crate::error::{Error, Result};

use super::crop::Crops;
use super::real::RealMotions;
use super::report::ClassifierDescription;

/// A classifier for one set of data.
pub struct Judge<'a> {
    classifier: &'a Classifier,
    description: ClassifierDescription,
    /// The data's action of every logit. // (logit)
    actions: Vec<usize>,
}

/// What a judge makes of some motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// // (motion, feature)
    pub features: Vec<f32>,
    /// The action with the largest logit. // (motion)
    pub actions: Vec<usize>,
}

impl<'a> Judge<'a> {
    /// Checks that the classifier fits. `order` names the actions of its logits where the file does not.
    ///
    /// # Errors
    /// Another number of joints or of actions than the data's; actions that have no or another name.
    pub fn new(
        classifier: &'a Classifier,
        description: ClassifierDescription,
        data: &RealMotions,
        order: Option<&[String]>,
    ) -> Result<Self> {
        let file = &description.file;
        if classifier.channel_count() != data.channel_count() {
            return Err(Error::bad_input(
                file,
                "inputs",
                format!("{} (joints times 3)", classifier.channel_count()),
                format!(
                    "{}, for the {} joints of the clips",
                    data.channel_count(),
                    data.joints.len()
                ),
                "give a classifier of these joints; `host-trainer classify` trains one",
            ));
        }
        if classifier.action_count() != data.actions.len() {
            return Err(Error::bad_input(
                file,
                "actions",
                classifier.action_count(),
                format!("{}, as the clips: {}", data.actions.len(), data.actions.join(", ")),
                "give a classifier of these actions; `host-trainer classify` trains one",
            ));
        }
        let names = classifier.actions().or(order).ok_or_else(|| {
            Error::bad_input(
                file,
                "names of the actions",
                "missing",
                "one a logit",
                "name the column of labels.csv with their numbers by --action-order-column",
            )
        })?;
        let actions =
            names.iter().map(|name| action_of(name, file, data)).collect::<Result<_>>()?;
        let judge = Self { classifier, description, actions };
        judge.check_permutation(data)?;
        Ok(judge)
    }

    fn check_permutation(&self, data: &RealMotions) -> Result<()> {
        let missing = (0..data.actions.len()).find(|action| !self.actions.contains(action));
        missing.map_or(Ok(()), |action| {
            Err(Error::bad_input(
                &self.description.file,
                "names of the actions",
                format!("without `{}`", data.actions[action]),
                format!("each of {} once", data.actions.join(", ")),
                "correct the names",
            ))
        })
    }

    /// Numbers of a feature vector.
    pub fn feature_count(&self) -> usize {
        self.classifier.feature_count()
    }

    /// For the report.
    pub fn description(&self) -> &ClassifierDescription {
        &self.description
    }

    /// Scores crops.
    pub fn score(&self, crops: &Crops, start: HiddenStart) -> Verdict {
        let scores = self.classifier.score(&crops.positions, crops.frame_count, start);
        let logits = scores.logits.chunks_exact(self.actions.len());
        let largest = |logits: &[f32]| {
            let last = logits.len() - 1;
            (0..last)
                .fold(last, |best, index| if logits[index] > logits[best] { index } else { best })
        };
        Verdict {
            actions: logits.map(|logits| self.actions[largest(logits)]).collect(),
            features: scores.features,
        }
    }
}

fn action_of(name: &str, file: &str, data: &RealMotions) -> Result<usize> {
    data.actions.iter().position(|action| action == name).ok_or_else(|| {
        Error::bad_input(
            file,
            "action",
            format!("`{name}`"),
            format!("one of the clips': {}", data.actions.join(", ")),
            "give a classifier of these actions; `host-trainer classify` trains one",
        )
    })
}
