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
    /// [`Interval`](crate::mixture::interval::Interval).
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
            self.intervals.iter().any(|interval| interval.action == index)
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::mixture::{Component, Factor};

    /// A mixture whose codes lie at `centre`.
    fn interval(action: usize, frames: RangeInclusive<usize>, centre: f64) -> IntervalMixture {
        IntervalMixture {
            action,
            frames_min: *frames.start(),
            frames_max: *frames.end(),
            clips: vec![0],
            mixture: Mixture {
                dimension_count: 1,
                components: vec![Component {
                    weight: 1.0,
                    mean: vec![centre],
                    factor: Factor::Diagonal(vec![0.01]),
                }],
            },
            report: FitReport { attempt_count: 1, fallback: None, log_likelihood_mean: 0.0 },
        }
    }

    fn mixture_set() -> MixtureSet {
        MixtureSet {
            actions: ["bow", "nod", "walk"].map(String::from).to_vec(),
            rate_hz: 20.0,
            intervals: vec![
                interval(0, 10..=19, 1.0),
                interval(0, 20..=40, 2.0),
                interval(2, 5..=9, 3.0),
            ],
        }
    }

    fn refusal(action: usize, frames: usize) -> String {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        mixture_set().sample(action, frames, &mut rng).unwrap_err().to_string()
    }

    #[test]
    fn untrained_duration_is_refused_with_action_seconds_range_and_remedy() {
        let expected = "action `bow`: duration is 41 frames (2.05 s), expected 10 to 40 frames \
            (0.50 to 2.00 s at 20 Hz), as in the training clips; \
            ask for a trained duration, or add --clamp to take the nearest";
        assert_eq!(refusal(0, 41), expected);
        assert!(refusal(0, 9).contains("duration is 9 frames (0.45 s)"));
        assert!(refusal(2, 0).contains("expected 5 to 9 frames"));
    }

    #[test]
    fn unknown_and_untrained_actions_are_refused_with_the_trained_ones() {
        assert!(refusal(3, 20).contains("action is number 3, expected one of bow, walk;"));
        assert!(refusal(1, 20).contains("action is `nod`, which has no training clips"));
        assert!(mixture_set().clamp_frames(1, 20).is_err());
    }

    #[test]
    fn duration_is_served_by_the_interval_that_contains_it() {
        let mixtures = mixture_set();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // 20 lies nearer to the centre of the first interval.
        for (frames, centre) in [(10, 1.0), (19, 1.0), (20, 2.0), (40, 2.0)] {
            let code = mixtures.sample(0, frames, &mut rng).unwrap();
            assert!((code[0] - centre).abs() < 0.2);
        }
    }

    #[test]
    fn clamped_duration_is_the_nearest_trained_one() {
        let mixtures = mixture_set();
        for (asked, clamped) in [(0, 10), (10, 10), (25, 25), (40, 40), (usize::MAX, 40)] {
            assert_eq!(mixtures.clamp_frames(0, asked).unwrap(), clamped);
        }
    }
}
