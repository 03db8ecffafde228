//! What the papers leave open about a measurement, settled.
//!
//! In:  the user's flags.
//! Out: [`Protocol`], to everything in `evaluate` and into its report.

use serde::Serialize;

use crate::classifier::HiddenStart;

/// How a measurement is made. The default is MotionINR's, with fresh draws in every repetition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Protocol {
    /// Repetitions; every one draws new motions, new windows and new pairs. Source: 20 in Action2Motion and MotionINR.
    pub repetitions: usize,
    /// Start of every random stream.
    pub seed: u64,
    /// The classifier's hidden state before frame 0.
    pub start: Start,
    /// How often each action is taken.
    pub actions: ActionShares,
    /// Poses that the classifier sees.
    pub frames: usize,
}

/// The classifier's hidden state before frame 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// Zeros, as MotionINR's evaluation
    Zeros,
    /// Draws from N(0, 1), as Action2Motion, ACTOR and ODMO
    Gaussian,
}

/// How often each action is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionShares {
    /// One motion a clip, with the clip's action and length.
    Data,
    /// Equally many of every action, each with the length of any clip of it; real clips likewise. Source: ODMO.
    Uniform {
        /// Of every action.
        motions_per_action: usize,
    },
}

impl Default for Protocol {
    fn default() -> Self {
        Self {
            repetitions: 20,
            seed: 1,
            start: Start::Zeros,
            actions: ActionShares::Data,
            frames: 60,
        }
    }
}

/// Sets of motions that one repetition scores; each has random streams of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// The training clips that everything is compared with.
    Real,
    /// The training clips again, in other windows: the row of real motions.
    RealAgain,
    /// Clips that training did not see.
    HeldOut,
    /// What the model makes.
    Generated,
}

impl Role {
    const COUNT: u64 = 4;

    /// Index of this role's streams in a repetition.
    pub fn stream_index(self, repetition: usize) -> u64 {
        repetition as u64 * Self::COUNT + self as u64
    }
}

impl Protocol {
    /// The classifier's start for one set of motions.
    pub(super) fn hidden_start(&self, role: Role, repetition: usize) -> HiddenStart {
        match self.start {
            Start::Zeros => HiddenStart::Zeros,
            Start::Gaussian => {
                let index = role.stream_index(repetition);
                HiddenStart::Gaussian { seed: self.seed.wrapping_mul(1 << 20).wrapping_add(index) }
            }
        }
    }
}
