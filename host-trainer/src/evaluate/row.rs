//! One row, repetition by repetition: from scored motions to figures.
//!
//! In:  [`Scored`] motions of one role, and the real side that they are compared with.
//! Out: [`Row`], whose means over the repetitions are [`Figures`].

use rand::Rng;

use super::crop::Crops;
use super::estimate::Estimate;
use super::frechet::Gaussian;
use super::judge::Verdict;
use super::physical::figures::{PhysicalFigures, Samples, Summaries};
use super::physical::ruler::Ruler;
use super::report::{ActionAccuracy, Figures};
use super::spread::{diversity, mean_nearest, multimodality, pairwise_distances};
use crate::error::Result;

/// Motions of one role in one repetition, scored.
#[derive(Clone, Debug)]
pub(super) struct Scored {
    /// The data's action of every motion. // (motion)
    pub actions: Vec<usize>,
    /// Features, and the actions that the classifier sees.
    pub verdict: Verdict,
    /// Fréchet's Gaussian of the features.
    pub gaussian: Gaussian,
    /// See [`pairwise_distances`]. // (action)
    pub pairwise: Vec<Option<f64>>,
    /// How they move; `None` for what is no body.
    pub samples: Option<Samples>,
}

impl Scored {
    /// `of` names the motions in messages; without a ruler nothing physical is measured.
    ///
    /// # Errors
    /// Too few motions for a covariance.
    pub fn new(
        crops: &Crops,
        actions: Vec<usize>,
        verdict: Verdict,
        [feature_count, action_count]: [usize; 2],
        ruler: Option<&Ruler>,
        of: &str,
    ) -> Result<Self> {
        let gaussian = Gaussian::fit(&verdict.features, feature_count, of)?;
        let pairwise = pairwise_distances(crops, &actions, action_count);
        let samples = ruler.map(|ruler| Samples::new(crops, ruler));
        Ok(Self { actions, verdict, gaussian, pairwise, samples })
    }
}

/// The real motions of one repetition, that others are compared with.
#[derive(Clone, Debug)]
pub(super) struct RealScores {
    /// Training clips.
    pub training: Scored,
    /// Fréchet's Gaussian of the clips that training did not see.
    pub held_out: Option<Gaussian>,
}

/// Figures of one row in one repetition.
#[derive(Clone, Debug)]
struct Values {
    fid: f64,
    fid_held_out: Option<f64>,
    diversity: f64,
    multimodality: f64,
    mms: f64,
    apd: f64,
    apd_normalized: f64,
    /// Right ones and all. // (action)
    right: Vec<(usize, usize)>,
    physical: Option<Summaries>,
}

/// Figures of one row in all repetitions so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Row(Vec<Values>);

impl Row {
    /// Adds one repetition.
    pub fn push(
        &mut self,
        motions: &Scored,
        real: &RealScores,
        feature_count: usize,
        rng: &mut impl Rng,
    ) {
        let (features, actions) = (&motions.verdict.features, &motions.actions);
        let action_count = real.training.pairwise.len();
        let mut right = vec![(0, 0); action_count];
        for (&action, &seen) in actions.iter().zip(&motions.verdict.actions) {
            right[action].0 += usize::from(action == seen);
            right[action].1 += 1;
        }
        let apd = motions.pairwise.iter().flatten().copied();
        let pairs = motions.pairwise.iter().zip(&real.training.pairwise);
        let shares = pairs.filter_map(|(one, real)| Some(100.0 * (*one)? / (*real)?));
        self.0.push(Values {
            fid: motions.gaussian.distance(&real.training.gaussian),
            fid_held_out: real.held_out.as_ref().map(|other| motions.gaussian.distance(other)),
            diversity: diversity(features, feature_count, rng),
            multimodality: multimodality(features, feature_count, actions, action_count, rng),
            mms: mean_nearest(features, &real.training.verdict.features, feature_count),
            apd: mean(apd),
            apd_normalized: mean(shares.filter(|share| share.is_finite())),
            right,
            physical: motions
                .samples
                .as_ref()
                .zip(real.training.samples.as_ref())
                .map(|(one, real)| one.summarize(real)),
        });
    }

    /// Means and intervals over the repetitions. `actions` are the data's names.
    pub fn figures(&self, actions: &[String]) -> Figures {
        let values = &self.0;
        let estimate = |of: fn(&Values) -> f64| Estimate::of(values.iter().map(of));
        let held_out: Option<Vec<f64>> = values.iter().map(|values| values.fid_held_out).collect();
        let accuracy_of = |action: usize| ActionAccuracy {
            action: actions[action].clone(),
            motion_count: values.first().map_or(0, |values| values.right[action].1),
            accuracy: Estimate::of(values.iter().map(|values| share([values.right[action]]))),
        };
        Figures {
            fid: estimate(|values| values.fid),
            fid_held_out: held_out.map(Estimate::of),
            accuracy: estimate(|values| share(values.right.iter().copied())),
            diversity: estimate(|values| values.diversity),
            multimodality: estimate(|values| values.multimodality),
            mms: estimate(|values| values.mms),
            apd: estimate(|values| values.apd),
            apd_normalized: estimate(|values| values.apd_normalized),
            physical: physical(values),
            accuracy_by_action: (0..actions.len()).map(accuracy_of).collect(),
        }
    }
}

/// `None` where a repetition measured nothing physical.
fn physical(values: &[Values]) -> Option<PhysicalFigures> {
    let summaries: Option<Vec<Summaries>> = values.iter().map(|values| values.physical).collect();
    summaries.map(|summaries| PhysicalFigures::new(&summaries))
}

fn share(right: impl IntoIterator<Item = (usize, usize)>) -> f64 {
    let sum = |(a, b): (usize, usize), (c, d): (usize, usize)| (a + c, b + d);
    let (right, all) = right.into_iter().fold((0, 0), sum);
    right as f64 / all as f64
}

/// 0 of nothing: where no action has two motions there are no pairs.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count.max(1))
}
