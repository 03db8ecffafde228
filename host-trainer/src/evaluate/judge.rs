//! A classifier that is known to fit the data: what scores crops, and in whose order the actions stand.
//!
//! In:  a classifier, the data, and where the classifier names no actions the order that the user gives.
//! Out: [`Judge`]; or the reason why any figure would be wrong.
//!
//! Why here: a classifier that was trained on other joints or actions gives figures too, and nothing in them looks
//! wrong. So what does not fit is refused before anything is measured.

use crate::classifier::example::Input;
use crate::classifier::{Classifier, HiddenStart};
use crate::error::{Error, Result};

use super::crop::Crops;
use super::papers::joints_of_classifier;
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
    /// Another number of joints or of actions than the data's; joints in another order, as far as both sides have
    /// names; actions that have no or another name.
    pub fn new(
        classifier: &'a Classifier,
        description: ClassifierDescription,
        data: &RealMotions,
        order: Option<&[String]>,
    ) -> Result<Self> {
        let file = &description.file;
        if classifier.channel_count() != data.channel_count() {
            let expected = match data.input {
                Input::Joints => format!(
                    "{}, three for each of {} joints",
                    data.channel_count(),
                    data.joints.len()
                ),
                Input::Channels => format!("{}, one a channel", data.channel_count()),
            };
            return Err(Error::bad_input(
                file,
                "inputs of a pose",
                classifier.channel_count(),
                expected,
                "give a classifier of these clips; `host-trainer classify` trains one",
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
        check_joints(classifier, &description, data)?;
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

    /// Refuses another length than the classifier was trained on, where its file says it.
    pub(super) fn check_frames(&self, frames: usize) -> Result<()> {
        let own = self.classifier.description().map(|own| own.settings.frames);
        own.filter(|own| *own != frames).map_or(Ok(()), |own| {
            let remedy = format!("evaluate with --frames {own}");
            let expected = format!("{own}, as in the classifier's training");
            Err(Error::bad_input(&self.description.file, "frames", frames, expected, remedy))
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

/// Refuses joints or channels of other names or another rate than those that the classifier was trained on, as far as
/// its file names them or it is one that is known.
fn check_joints(
    classifier: &Classifier,
    description: &ClassifierDescription,
    data: &RealMotions,
) -> Result<()> {
    let refused = |field: String, value: String, expected: String| {
        let expected = format!("{expected}, as in the classifier's training");
        let remedy = "bring the clips into its form, or give a classifier of these clips";
        Err(Error::bad_input(&description.file, field, value, expected, remedy))
    };
    let own = classifier.description();
    if let Some(own) = own.filter(|own| own.input != data.input) {
        let (found, expected) = (format!("{:?}", data.input), format!("{:?}", own.input));
        return refused("input".to_owned(), found, expected);
    }
    if let Some(own) = own.filter(|own| (own.rate_hz - data.rate_hz).abs() > 1e-3) {
        let (found, expected) = (format!("{} Hz", data.rate_hz), format!("{} Hz", own.rate_hz));
        return refused("rate of the clips".to_owned(), found, expected);
    }
    let known = joints_of_classifier(&description.sha256);
    let Some(expected) = own.map(|own| own.names.clone()).or(known) else { return Ok(()) };
    // Joints of npy files have no names unless the user gives them.
    let is_named = |index: usize, name: &str| name != format!("joint{index:02}");
    for (index, (name, expected)) in data.joints.iter().zip(&expected).enumerate() {
        if name != expected && is_named(index, name) && is_named(index, expected) {
            let (found, expected) = (format!("`{name}` in the clips"), format!("`{expected}`"));
            return refused(format!("joint {index}"), found, expected);
        }
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::Description;
    use crate::classifier::example::Examples;
    use crate::classifier::example::Input;
    use crate::classifier::train::Settings;
    use crate::evaluate::specimen::{clip_set, write_classifier};

    fn data(actions: &[&str]) -> RealMotions {
        let counts: Vec<(&str, usize)> = actions.iter().map(|&action| (action, 3)).collect();
        RealMotions::new(&clip_set(&counts, 20), None).unwrap()
    }

    fn classifier(channel_count: usize, action_count: usize, names: Option<&[&str]>) -> Classifier {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("classifier.safetensors");
        write_classifier(&file, channel_count, action_count, names);
        Classifier::load(&file).unwrap()
    }

    fn description(sha256: &str) -> ClassifierDescription {
        ClassifierDescription { file: "judge".to_owned(), sha256: sha256.to_owned() }
    }

    fn refusal(classifier: &Classifier, data: &RealMotions, order: Option<&[String]>) -> String {
        let judge = Judge::new(classifier, description("00"), data, order);
        judge.err().expect("a refusal").to_string()
    }

    #[test]
    fn classifier_of_other_joints_is_refused() {
        let message =
            refusal(&classifier(72, 2, Some(&["bow", "nod"])), &data(&["bow", "nod"]), None);
        assert!(
            message.contains("inputs of a pose is 72, expected 9, three for each of 3 joints"),
            "{message}"
        );
    }

    #[test]
    fn classifier_of_more_or_fewer_actions_is_refused() {
        for names in [&["bow"][..], &["bow", "nod", "wave"]] {
            let classifier = classifier(9, names.len(), Some(names));
            let message = refusal(&classifier, &data(&["bow", "nod"]), None);
            assert!(message.contains("expected 2, as the clips: bow, nod"), "{message}");
        }
    }

    #[test]
    fn classifier_of_other_actions_is_refused() {
        let message =
            refusal(&classifier(9, 2, Some(&["bow", "run"])), &data(&["bow", "nod"]), None);
        assert!(message.contains("`run`, expected one of the clips': bow, nod"), "{message}");
        let message =
            refusal(&classifier(9, 2, Some(&["bow", "bow"])), &data(&["bow", "nod"]), None);
        assert!(message.contains("without `nod`"), "{message}");
    }

    #[test]
    fn classifier_without_names_needs_an_order() {
        let (classifier, data) = (classifier(9, 2, None), data(&["bow", "nod"]));
        assert!(refusal(&classifier, &data, None).contains("--action-order-column"));
        let order = ["nod", "bow"].map(str::to_owned);
        let judge = Judge::new(&classifier, description("00"), &data, Some(&order)).unwrap();
        assert_eq!(judge.actions, [1, 0]);
    }

    #[test]
    fn joints_in_another_order_than_a_known_classifier_are_refused() {
        let (mut data, classifier) = (data(&["bow", "nod"]), classifier(9, 2, None));
        let description = description(crate::evaluate::papers::HUMANACT12_CLASSIFIER);
        data.joints = crate::body::skeleton::Skeleton::smpl24().names;
        check_joints(&classifier, &description, &data).unwrap();
        data.joints.swap(4, 5);
        let message = check_joints(&classifier, &description, &data).unwrap_err().to_string();
        assert!(message.contains("joint 4 is `right_knee` in the clips"), "{message}");
        data.joints = (0..24).map(|index| format!("joint{index:02}")).collect();
        check_joints(&classifier, &description, &data).unwrap();
    }

    #[test]
    fn clips_of_another_form_than_a_described_classifiers_are_refused() {
        let data = data(&["bow", "nod"]);
        let examples = Examples::new(&clip_set(&[("bow", 3), ("nod", 3)], 20), None).unwrap();
        let described = |rate_hz: f64, names: [&str; 3]| {
            classifier(9, 2, Some(&["bow", "nod"])).with_description(Description {
                input: examples.input,
                names: names.map(str::to_owned).to_vec(),
                rate_hz,
                settings: Settings { frames: 30, ..Settings::default() },
                config_hash: String::new(),
                data_hash: String::new(),
                training_clip_count: 6,
                held_out: Vec::new(),
                training_accuracy: 1.0,
                held_out_accuracy: None,
            })
        };
        let names = ["hip", "knee", "toe"];
        assert!(refusal(&described(50.0, names), &data, None).contains("20 Hz, expected 50 Hz"));
        let message = refusal(&described(20.0, ["hip", "toe", "knee"]), &data, None);
        assert!(message.contains("joint 1 is `knee` in the clips, expected `toe`"), "{message}");
        let classifier = described(20.0, names);
        let judge = Judge::new(&classifier, description("00"), &data, None).unwrap();
        judge.check_frames(30).unwrap();
        assert!(judge.check_frames(60).unwrap_err().to_string().contains("--frames 30"));
    }

    #[test]
    fn verdict_is_in_the_order_of_the_data() {
        let (classifier, data) = (classifier(9, 2, Some(&["nod", "bow"])), data(&["bow", "nod"]));
        let judge = Judge::new(&classifier, description("00"), &data, None).unwrap();
        let mut crops = Crops::new(20, 9, Input::Joints);
        for clip in &data.training {
            let window = crate::evaluate::crop::Window { first: 0, count: 20 };
            crops.push(window, &clip.positions[..20 * 9]);
        }
        let scores = classifier.score(&crops.positions, 20, HiddenStart::Zeros);
        let verdict = judge.score(&crops, HiddenStart::Zeros);
        for (logits, action) in scores.logits.chunks(2).zip(verdict.actions) {
            // The second logit is `bow`, which comes first in the data.
            assert_eq!(action, usize::from(logits[0] > logits[1]));
        }
    }
}
