//! Station 5, complete: one [`Mixture`] for every action and interval of lengths.
//!
//! In:  `fit`, or its cache `mixture_file`.
//! Out: sequence codes, to `generate`, `evaluate` and `quantize`.
//!
//! Source: Cervantes et al., ECCV 2022, Algorithm 1. A duration is served by the interval that
//! contains it, and no other \[ours\]; \[published code\] takes the interval with the nearest
//! centre, so it serves any duration whatsoever.

use std::ops::RangeInclusive;

use rand::Rng;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::mixture::Mixture;

/// What the fit had to give up because components copied clips.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fallback {
    /// Fewer components than there are clips to carry them.
    FewerComponents,
    /// One Gaussian over all draws.
    SingleGaussian,
    /// One Gaussian with diagonal covariance, where a full one could not be computed.
    DiagonalGaussian,
}

/// How one fit went.
#[derive(Clone, Debug, PartialEq)]
pub struct FitReport {
    /// Numbers of components tried.
    pub attempt_count: usize,
    /// What was given up; `None` when the first attempt was kept.
    pub fallback: Option<Fallback>,
    /// Mean log-density of the draws, in nats.
    pub log_likelihood_mean: f64,
}

/// The density over the codes of one action and one interval of lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct IntervalMixture {
    /// Index into the dataset's actions.
    pub action: usize,
    /// Least number of poses served.
    pub frames_min: usize,
    /// Greatest number of poses served, inclusive.
    pub frames_max: usize,
    /// Rows of the code table that the mixture was fitted to; see
    /// [`Interval`](crate::interval::Interval).
    pub clips: Vec<usize>,
    /// The density.
    pub mixture: Mixture,
    /// How the fit went.
    pub report: FitReport,
}

/// The mixtures of all actions; those of one action are in order of length and leave no gap.
#[derive(Clone, Debug, PartialEq)]
pub struct MixtureSet {
    /// Names of the actions, as in the dataset.
    pub actions: Vec<String>,
    /// Poses per second, to speak of durations.
    pub rate_hz: f64,
    /// The mixtures, action by action.
    pub intervals: Vec<IntervalMixture>,
}

impl MixtureSet {
    /// Draws a sequence code for a motion of `frames` poses.
    ///
    /// # Errors
    /// * `BadInput`: the action does not exist or has no clips, or no interval holds `frames`. To
    ///   serve such a request from the nearest duration, pass what [`MixtureSet::clamp_frames`]
    ///   returns, here and to the decoder.
    pub fn sample<R: Rng + ?Sized>(
        &self,
        action: usize,
        frames: usize,
        rng: &mut R,
    ) -> Result<Vec<f64>> {
        Ok(self.interval(action, frames)?.mixture.sample(rng))
    }

    /// The mixture that serves `frames` poses of an action; errors as [`MixtureSet::sample`].
    pub fn interval(&self, action: usize, frames: usize) -> Result<&IntervalMixture> {
        let trained = self.trained_frames(action)?;
        self.intervals
            .iter()
            .find(|interval| {
                interval.action == action
                    && (interval.frames_min..=interval.frames_max).contains(&frames)
            })
            .ok_or_else(|| self.untrained_duration(action, frames, trained))
    }

    /// The trained number of poses nearest to `frames`.
    ///
    /// # Errors
    /// * `BadInput`: the action does not exist or has no clips.
    pub fn clamp_frames(&self, action: usize, frames: usize) -> Result<usize> {
        let trained = self.trained_frames(action)?;
        Ok(frames.clamp(*trained.start(), *trained.end()))
    }

    /// Numbers of poses that an action was trained with; errors as [`MixtureSet::clamp_frames`].
    pub fn trained_frames(&self, action: usize) -> Result<RangeInclusive<usize>> {
        let of_action = || self.intervals.iter().filter(|i| i.action == action);
        let frames_min = of_action().map(|i| i.frames_min).min();
        let frames_max = of_action().map(|i| i.frames_max).max();
        match (frames_min, frames_max) {
            (Some(min), Some(max)) => Ok(min..=max),
            _ => Err(self.untrained_action(action)),
        }
    }

    fn untrained_duration(
        &self,
        action: usize,
        frames: usize,
        trained: RangeInclusive<usize>,
    ) -> Error {
        let seconds = |frames: usize| frames as f64 / self.rate_hz;
        let (min, max) = trained.into_inner();
        Error::bad_input(
            format!("action `{}`", self.actions[action]),
            "duration",
            format!("{frames} frames ({:.2} s)", seconds(frames)),
            format!(
                "{min} to {max} frames ({:.2} to {:.2} s at {} Hz), as in the training clips",
                seconds(min),
                seconds(max),
                self.rate_hz
            ),
            "ask for a trained duration, or add --clamp to take the nearest",
        )
    }

    fn untrained_action(&self, action: usize) -> Error {
        let value = match self.actions.get(action) {
            Some(name) => format!("`{name}`, which has no training clips"),
            None => format!("number {action}"),
        };
        let trained = |&(index, _): &(usize, &String)| {
            self.intervals
                .iter()
                .any(|interval| interval.action == index)
        };
        let names: Vec<&str> = self
            .actions
            .iter()
            .enumerate()
            .filter(trained)
            .map(|(_, name)| name.as_str())
            .collect();
        Error::bad_input(
            "mixture",
            "action",
            value,
            format!("one of {}", names.join(", ")),
            "ask for a trained action",
        )
    }
}
