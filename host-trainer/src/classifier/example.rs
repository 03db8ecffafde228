//! Clips as a classifier sees them.
//!
//! In:  the clips of both sides of the split, as imported.
//! Out: [`Examples`]: for bodies joint positions in metres, for everything else the channels, standardised.
//!
//! Why here: the published classifiers look at joints in metres without any standardisation, and those of the user's
//! own bodies should be comparable. Servos have a unit each, so their channels are brought to a common size while the
//! classifier learns; afterwards that is folded into its first weights, and it reads plain channels.

use rand::Rng;
use serde::{Deserialize, Serialize};

use crate::checkpoint::dataset_hash;
use crate::clip::ClipSet;
use crate::dataset::{self, ClipDescription, Dataset, DatasetDescription, DatasetOptions};
use crate::error::{Error, Result};
use crate::evaluate::crop::Window;
use crate::evaluate::real::PoseReader;
use crate::float_model::DenseLayer;

/// What a classifier reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// x, y and z of every joint in metres, minus the root's at the first frame.
    Joints,
    /// The channels of the clips, in their own units.
    Channels,
}

/// A clip, ready to be cropped.
#[derive(Clone, Debug, PartialEq)]
pub struct Example {
    /// Name of the clip.
    pub name: String,
    /// Index into the actions.
    pub action: usize,
    /// // (frame, channel)
    pub poses: Vec<f32>,
}

/// All that a classifier learns from and is examined by.
#[derive(Clone, Debug, PartialEq)]
pub struct Examples {
    /// What the poses are.
    pub input: Input,
    /// Joints or channels, in order.
    pub names: Vec<String>,
    /// Names of the actions, sorted.
    pub actions: Vec<String>,
    /// Poses per second.
    pub rate_hz: f64,
    /// To learn from.
    pub training: Vec<Example>,
    /// To be examined by; may be empty.
    pub held_out: Vec<Example>,
    /// SHA-256 of the training clips, hexadecimal.
    pub data_hash: String,
    /// Of the training clips; `Channels` are standardised by it.
    description: DatasetDescription,
}

impl Examples {
    /// Brings clips into the form that a classifier reads.
    ///
    /// # Errors
    /// * Whatever `dataset` refuses: a clip without action, with fewer than two poses, a value that is not finite.
    /// * Fewer than two actions; with clips held out, an action of which training has them all.
    pub fn new(training: &ClipSet, held_out: Option<&ClipSet>) -> Result<Self> {
        let mut dataset = dataset::build(training, &DatasetOptions::default())?;
        let actions = dataset.description.actions.clone();
        check_actions(&actions, training, held_out)?;
        let held_out = held_out.map(|clips| dataset::build_held_out(clips, &mut dataset));
        let held_out = held_out.transpose()?;
        let layout = &training.layout;
        let reader = PoseReader::new(layout, training.skeleton.as_ref());
        let names = match (reader.input(), &training.skeleton) {
            (Input::Channels, _) => layout.channel_names(),
            (Input::Joints, Some(skeleton)) => skeleton.names.clone(),
            (Input::Joints, None) => layout.groups.iter().map(|group| group.name.clone()).collect(),
        };
        let read = |dataset: &Dataset| examples(dataset, &reader);
        Ok(Self {
            input: reader.input(),
            names,
            actions,
            rate_hz: training.rate_hz,
            training: read(&dataset),
            held_out: held_out.as_ref().map(read).unwrap_or_default(),
            data_hash: dataset_hash(&dataset),
            description: dataset.description,
        })
    }

    /// Numbers of one pose.
    pub fn channel_count(&self) -> usize {
        match self.input {
            Input::Joints => 3 * self.names.len(),
            Input::Channels => self.names.len(),
        }
    }

    /// Appends equally many poses of any example: a random window, or all of it and its last pose again and again;
    /// joints minus the root of the first pose kept.
    ///
    /// # Source
    /// Guo et al., Action2Motion, ACM MM 2020, and its public code.
    ///
    /// # Shapes
    /// `motions` (motion, frame, channel)
    pub fn crop(
        &self,
        example: &Example,
        frame_count: usize,
        rng: &mut impl Rng,
        motions: &mut Vec<f32>,
    ) {
        let channel_count = self.channel_count();
        let own_count = example.poses.len() / channel_count;
        let Window { first, .. } = Window::draw(own_count, frame_count, rng);
        let root = match self.input {
            Input::Joints => &example.poses[first * channel_count..][..3],
            Input::Channels => &[0.0],
        };
        for frame in first..first + frame_count {
            let pose = &example.poses[frame.min(own_count - 1) * channel_count..][..channel_count];
            motions.extend(pose.iter().zip(root.iter().cycle()).map(|(value, root)| value - root));
        }
    }

    /// Folds the standardisation into the first layer, which then reads the clips' own channels.
    pub fn fold(&self, first: &mut DenseLayer) {
        if self.input == Input::Joints {
            return;
        }
        let description = &self.description;
        for (row, bias) in first.weights.chunks_exact_mut(first.input_count).zip(&mut first.bias) {
            for (channel, weight) in row.iter_mut().enumerate() {
                // A channel that never moved told nothing, and must not begin to.
                let is_constant = description.is_constant(channel);
                *weight = if is_constant { 0.0 } else { *weight / description.scale[channel] };
                *bias -= *weight * description.mean[channel];
            }
        }
    }
}

fn check_actions(actions: &[String], training: &ClipSet, held_out: Option<&ClipSet>) -> Result<()> {
    let remedy = "label more clips, or join actions by --label-groups";
    if actions.len() < 2 {
        let expected = "2 or more, to tell apart";
        return Err(Error::bad_input(
            "clips",
            "number of actions",
            actions.len(),
            expected,
            remedy,
        ));
    }
    let Some(held_out) = held_out else { return Ok(()) };
    let count = |clips: &ClipSet, action: &str| {
        clips.clips.iter().filter(|clip| clip.action == action).count()
    };
    let lonely =
        actions.iter().find(|action| count(training, action) + count(held_out, action) < 2);
    match lonely {
        Some(action) => Err(Error::bad_input(
            "clips",
            format!("clips of action {action}"),
            1,
            "2 or more: one to learn from, one to be examined by",
            format!("{remedy}, or train without an examination by --hold-out 0"),
        )),
        None => Ok(()),
    }
}

/// Clips as the classifier learns from them: of a body positions, otherwise standardised channels.
fn examples(dataset: &Dataset, reader: &PoseReader) -> Vec<Example> {
    let description = &dataset.description;
    let read = |(index, clip): (usize, &ClipDescription)| {
        let mut poses = dataset.clip_poses(index).to_vec();
        if reader.input() == Input::Joints {
            description.destandardize(&mut poses);
            let own = poses.chunks_exact(description.layout.channel_count());
            let mut seen = Vec::new();
            own.for_each(|pose| reader.read(pose, &mut seen));
            poses = seen;
        }
        Example { name: clip.name.clone(), action: clip.action, poses }
    };
    description.clips.iter().enumerate().map(read).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::character;
    use crate::evaluate::specimen;

    fn refusal(training: &ClipSet, held_out: Option<&ClipSet>) -> String {
        Examples::new(training, held_out).unwrap_err().to_string()
    }

    #[test]
    fn single_action_is_refused() {
        let message = refusal(&specimen::clip_set(&[("nod", 9)], 20), None);
        assert!(message.contains("number of actions is 1, expected 2 or more"), "{message}");
    }

    #[test]
    fn action_with_one_clip_is_refused_by_name_when_clips_are_held_out() {
        let training = specimen::clip_set(&[("bow", 1), ("nod", 8)], 20);
        let held_out = specimen::clip_set(&[("nod", 2)], 20);
        let message = refusal(&training, Some(&held_out));
        assert!(message.contains("clips of action bow is 1"), "{message}");
        assert!(message.contains("--hold-out 0"), "{message}");
        assert!(Examples::new(&training, None).is_ok());
    }

    #[test]
    fn joints_start_at_the_first_kept_root_and_short_clips_wait() {
        let examples =
            Examples::new(&specimen::clip_set(&[("bow", 1), ("nod", 1)], 20), None).unwrap();
        assert_eq!((examples.input, examples.channel_count()), (Input::Joints, 9));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut motions = Vec::new();
        for frame_count in [7, 30] {
            motions.clear();
            examples.crop(&examples.training[0], frame_count, &mut rng, &mut motions);
            assert_eq!(motions.len(), frame_count * 9);
            assert_eq!(motions[..3], [0.0; 3]);
        }
        assert_eq!(motions[19 * 9..20 * 9], motions[29 * 9..]);
    }

    #[test]
    fn folded_weights_read_plain_channels() {
        let clip_set = character::clip_set(3, 2);
        let examples = Examples::new(&clip_set, None).unwrap();
        assert_eq!(examples.input, Input::Channels);
        let channel_count = examples.channel_count();
        let weights = (0..channel_count).map(|index| (index as f32 + 1.0).sin()).collect();
        let mut layer = DenseLayer { weights, ..DenseLayer::zeros(channel_count, 1) };
        let product = |layer: &DenseLayer, pose: &[f32]| {
            let products = layer.weights.iter().zip(pose).map(|(weight, value)| weight * value);
            products.sum::<f32>() + layer.bias[0]
        };
        let standardized = product(&layer, &examples.training[0].poses[..channel_count]);
        examples.fold(&mut layer);
        let plain = product(&layer, &clip_set.clips[0].poses[..channel_count]);
        assert!((standardized - plain).abs() < 1e-3, "{standardized} {plain}");
    }
}
