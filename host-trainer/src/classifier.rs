//! The judge of an evaluation: a recurrent network that says which action a motion shows, and sums it up in features.
//!
//! Two layers of gated recurrent units run over the frames; the last state gives `tanh(linear1)`, the *features* that
//! FID and its relatives compare, and `linear2` of them gives one logit an action.
//!
//! In:  motions as the papers prepare them: joint positions minus the first frame's root; a file of weights.
//! Out: [`Scores`] to `evaluate`.
//!
//! Why here: figures measured with the published weights stand beside the papers' tables, so the arithmetic has to be
//! PyTorch's; the published outputs of real clips are the test.
//!
//! Source: Guo et al., Action2Motion, ACM MM 2020; its public code and weights.

mod backward;
pub mod example;
mod file;
mod gate;
mod lesson;
mod recurrent;
#[cfg(test)]
mod specimen;
pub mod train;

pub use file::Description;

use faer::Accum;
use rand::RngExt;
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::float_model::DenseLayer;
use crate::float_model::forward::{matrix, matrix_mut, multiply};
use crate::random::{Purpose, stream};
use crate::simd;
use recurrent::{LayerTrace, RecurrentLayer};

/// A trained classifier.
#[derive(Clone, Debug, PartialEq)]
pub struct Classifier {
    /// Of every recurrent layer the input half and the recurrent half; then features; then logits.
    layers: Vec<DenseLayer>,
    actions: Option<Vec<String>>,
    description: Option<Description>,
}

/// The hidden state before frame 0; the papers differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HiddenStart {
    /// Zeros, as MotionINR's evaluation.
    Zeros,
    /// Draws from N(0, 1), as Action2Motion, ACTOR and ODMO; motion i of a call has a stream of its own.
    Gaussian {
        /// Of the streams; a fresh one for every repetition.
        seed: u64,
    },
}

/// What the classifier makes of some motions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scores {
    /// Between −1 and 1. // (motion, feature)
    pub features: Vec<f32>,
    /// Before any softmax. // (motion, action)
    pub logits: Vec<f32>,
}

/// Motions that go through the frames together. Fixed, so that results do not depend on the number of threads.
const MOTIONS_PER_BLOCK: usize = 64;

impl Classifier {
    /// Numbers of one pose: joints times 3.
    pub fn channel_count(&self) -> usize {
        self.layers[0].input_count
    }

    /// Actions that it tells apart.
    pub fn action_count(&self) -> usize {
        self.layers[self.layers.len() - 1].output_count
    }

    /// Features of a motion.
    pub fn feature_count(&self) -> usize {
        self.layers[self.layers.len() - 2].output_count
    }

    /// Names of the actions in the order of the logits, if the file has them. Action2Motion's weights come without; the
    /// conversions in `shared/data` have them.
    pub fn actions(&self) -> Option<&[String]> {
        self.actions.as_deref()
    }

    /// What it was trained on; only files of `host-trainer classify` say it.
    pub fn description(&self) -> Option<&Description> {
        self.description.as_ref()
    }

    /// The same classifier, which now says where it comes from.
    pub fn with_description(self, description: Description) -> Self {
        Self { description: Some(description), ..self }
    }

    /// Features and logits of motions.
    ///
    /// # Shapes
    /// `motions` (motion, frame, channel)
    ///
    /// # Panics
    /// When `motions` is not whole motions of `frame_count` poses.
    pub fn score(&self, motions: &[f32], frame_count: usize, start: HiddenStart) -> Scores {
        let len = frame_count * self.channel_count();
        assert!(len > 0 && motions.len().is_multiple_of(len), "whole motions");
        let mut scores = Scores {
            features: vec![0.0; motions.len() / len * self.feature_count()],
            logits: vec![0.0; motions.len() / len * self.action_count()],
        };
        let features = scores.features.par_chunks_mut(MOTIONS_PER_BLOCK * self.feature_count());
        let logits = scores.logits.par_chunks_mut(MOTIONS_PER_BLOCK * self.action_count());
        let blocks = motions.par_chunks(MOTIONS_PER_BLOCK * len).enumerate();
        blocks.zip(features.zip(logits)).for_each_init(
            || vec![LayerTrace::default(); self.recurrent_count()],
            |traces, ((index, motions), (features, logits))| {
                let first_motion = index * MOTIONS_PER_BLOCK;
                let starts = self.hidden_starts(start, first_motion, motions.len() / len);
                self.score_block(&frames_first(motions, frame_count, len), &starts, traces);
                self.conclude(traces, features, logits);
            },
        );
        scores
    }

    /// The hidden state of every recurrent layer before frame 0. // (layer), (motion, unit)
    fn hidden_starts(&self, start: HiddenStart, first: usize, count: usize) -> Vec<Vec<f32>> {
        let unit_count = self.recurrent(0).unit_count();
        let mut starts = vec![vec![0.0; count * unit_count]; self.recurrent_count()];
        if let HiddenStart::Gaussian { seed } = start {
            for motion in 0..count {
                let mut rng = stream(seed, Purpose::HiddenStart, (first + motion) as u64);
                for layer in &mut starts {
                    let state = &mut layer[motion * unit_count..][..unit_count];
                    state.fill_with(|| rng.sample(StandardNormal));
                }
            }
        }
        starts
    }

    /// All recurrent layers over one block.
    ///
    /// # Shapes
    /// `poses` (frame, motion, channel) · `starts` (layer), (motion, unit)
    fn score_block(&self, poses: &[f32], starts: &[Vec<f32>], traces: &mut [LayerTrace]) {
        for (index, start) in starts.iter().enumerate() {
            let (before, after) = traces.split_at_mut(index);
            let inputs = before.last().map_or(poses, |trace| &trace.hidden[start.len()..]);
            self.recurrent(index).forward(inputs, start, &mut after[0]);
        }
    }

    /// Features and logits from the last state.
    ///
    /// # Shapes
    /// `features` (motion, feature) · `logits` (motion, action)
    fn conclude(&self, traces: &[LayerTrace], features: &mut [f32], logits: &mut [f32]) {
        let [.., feature_layer, logit_layer] = &self.layers[..] else {
            unreachable!("a classifier ends in two layers");
        };
        let motion_count = features.len() / self.feature_count();
        let unit_count = feature_layer.input_count;
        let states = traces.last().map_or(&[][..], |trace| &trace.hidden);
        let last = &states[states.len() - motion_count * unit_count..];
        apply(feature_layer, last, features);
        features.iter_mut().for_each(|feature| *feature = gate::tanh(*feature));
        apply(logit_layer, features, logits);
    }

    fn recurrent_count(&self) -> usize {
        (self.layers.len() - 2) / 2
    }

    fn recurrent(&self, index: usize) -> RecurrentLayer<'_> {
        RecurrentLayer { input: &self.layers[2 * index], recurrent: &self.layers[2 * index + 1] }
    }
}

/// `outputs = inputs · weightsᵀ + bias`.
fn apply(layer: &DenseLayer, inputs: &[f32], outputs: &mut [f32]) {
    let weights = matrix(&layer.weights, layer.input_count).transpose();
    let target = matrix_mut(outputs, layer.output_count);
    multiply(target, Accum::Replace, matrix(inputs, layer.input_count), weights);
    outputs.chunks_exact_mut(layer.output_count).for_each(|row| simd::add(row, &layer.bias));
}

/// (motion, frame, channel) → (frame, motion, channel); `len` is that of one motion.
fn frames_first(motions: &[f32], frame_count: usize, len: usize) -> Vec<f32> {
    let channel_count = len / frame_count;
    let poses = |frame: usize| {
        motions.chunks_exact(len).map(move |m| &m[frame * channel_count..][..channel_count])
    };
    (0..frame_count).flat_map(poses).flatten().copied().collect()
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use super::specimen::{classifier, reference, values};
    use super::*;
    use crate::checkpoint::tensor_file::TensorReader;

    /// The folder `shared/data`, or `None` with a loud word when this machine has no such data.
    fn shared_data() -> Option<PathBuf> {
        let roots = ["/../../shared/data", "/../../../shared/data"];
        let folder = |up| PathBuf::from(format!("{}{up}", env!("CARGO_MANIFEST_DIR")));
        let found = roots.into_iter().map(folder).find(|folder| folder.exists());
        if found.is_none() {
            assert!(std::env::var_os("CI").is_none(), "CI needs shared/data");
            eprintln!("SKIPPED: shared/data is not on this machine");
        }
        found
    }

    /// A clip of HumanAct12 as the papers' evaluation sees it: minus the first frame's root.
    fn from_first_root(file: &std::path::Path) -> Vec<f32> {
        let bytes = fs::read(file).unwrap();
        let mut poses: Vec<f32> = npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap();
        let root: [f32; 3] = poses[..3].try_into().unwrap();
        poses.iter_mut().enumerate().for_each(|(index, value)| *value -= root[index % 3]);
        poses
    }

    fn largest_error(found: &[f32], expected: &[f32]) -> f32 {
        assert_eq!(found.len(), expected.len());
        found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn published_weights_give_the_published_outputs_of_whole_clips() {
        let Some(data) = shared_data() else { return };
        let folder = data.join("a2m_classifiers");
        let classifier = Classifier::load(&folder.join("humanact12.safetensors")).unwrap();
        let sizes =
            [classifier.channel_count(), classifier.feature_count(), classifier.action_count()];
        assert_eq!(sizes, [72, 30, 12]);
        assert_eq!(classifier.actions().unwrap()[1], "walk");
        let golden = folder.join("humanact12.golden_zero_h0.safetensors");
        let bytes = fs::read(&golden).unwrap();
        let golden = TensorReader::parse(&bytes, &golden, "").unwrap();
        let clips = data.join("humanact12/clips");
        let mut largest = 0.0_f32;
        let mut count = 0;
        for file in fs::read_dir(clips).unwrap().map(|entry| entry.unwrap().path()) {
            let name = file.file_stem().unwrap().to_string_lossy().into_owned();
            let Ok(features) = golden.floats(&format!("{name}/feature30"), &[30]) else { continue };
            let logits = golden.floats(&format!("{name}/logits"), &[12]).unwrap();
            let poses = from_first_root(&file);
            let scores = classifier.score(&poses, poses.len() / 72, HiddenStart::Zeros);
            largest = largest.max(largest_error(&scores.features, &features));
            largest = largest.max(largest_error(&scores.logits, &logits));
            count += 1;
        }
        eprintln!("largest error of {count} clips: {largest:e}");
        assert_eq!(count, 8);
        assert!(largest < 2e-5, "{largest}");
    }

    #[test]
    fn forward_pass_equals_the_formula_in_f64() {
        let classifier = classifier(6, 4);
        let poses = values(5 * 6);
        let (features, logits) = reference(&classifier, &poses);
        let scores = classifier.score(&poses, 5, HiddenStart::Zeros);
        for (found, expected) in scores.features.iter().zip(&features) {
            assert!((f64::from(*found) - expected).abs() < 1e-5);
        }
        for (found, expected) in scores.logits.iter().zip(&logits) {
            assert!((f64::from(*found) - expected).abs() < 1e-5);
        }
    }

    #[test]
    fn scores_do_not_depend_on_the_number_of_threads() {
        let classifier = classifier(6, 8);
        let motions = values(200 * 7 * 6);
        let score = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| classifier.score(&motions, 7, HiddenStart::Gaussian { seed: 3 }))
        };
        assert_eq!(score(1), score(3));
    }

    #[test]
    fn gaussian_start_changes_the_scores_with_its_seed_only() {
        let classifier = classifier(6, 8);
        let motions = values(3 * 7 * 6);
        let score = |start| classifier.score(&motions, 7, start);
        let first = score(HiddenStart::Gaussian { seed: 1 });
        assert_eq!(first, score(HiddenStart::Gaussian { seed: 1 }));
        assert_ne!(first, score(HiddenStart::Gaussian { seed: 2 }));
        assert_ne!(first, score(HiddenStart::Zeros));
        let starts = classifier.hidden_starts(HiddenStart::Gaussian { seed: 1 }, 0, 4000);
        for layer in starts {
            let count = layer.len() as f32;
            let mean = layer.iter().sum::<f32>() / count;
            let variance = layer.iter().map(|x| x * x).sum::<f32>() / count;
            assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.03, "{mean} {variance}");
        }
    }

    #[test]
    fn no_motions_have_no_scores() {
        assert_eq!(classifier(6, 8).score(&[], 7, HiddenStart::Zeros), Scores::default());
    }
}
