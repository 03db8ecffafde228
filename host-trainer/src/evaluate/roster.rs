//! Which motions one repetition scores, and from which random streams everything about them is drawn.
//!
//! In:  the data, the protocol.
//! Out: clips that stand for motions (action and length), windows, seeds.
//!
//! Why here: every set of motions has streams of its own, addressed by role and repetition. So a figure does not change
//! when another one is measured beside it, and nothing is drawn twice.

use rand::{Rng, RngExt};

use super::crop::{Crops, Window};
use super::protocol::{ActionShares, Protocol, Role};
use super::real::{RealMotion, RealMotions};
use crate::error::{Error, Result};
use crate::random::{Purpose, stream};

/// The clips of every action.
pub(super) struct Roster<'a> {
    data: &'a RealMotions,
    protocol: &'a Protocol,
    /// // (action)
    training_of_action: Vec<Vec<usize>>,
    /// // (action)
    held_out_of_action: Vec<Vec<usize>>,
}

/// Motions of one role in one repetition.
pub(super) struct Chosen<'a> {
    /// The clips that stand for them. // (motion)
    pub clips: Vec<&'a RealMotion>,
    /// Their numbers among the clips of that side of the split. // (motion)
    pub indices: Vec<usize>,
    /// The frames that are kept. // (motion)
    pub windows: Vec<Window>,
    /// Of each motion's own stream. // (motion)
    pub seeds: Vec<u64>,
}

impl<'a> Roster<'a> {
    /// # Errors
    /// An action without training clips.
    pub fn new(data: &'a RealMotions, protocol: &'a Protocol) -> Result<Self> {
        let of_action = |clips: &[RealMotion]| {
            let mut of_action = vec![Vec::new(); data.actions.len()];
            clips.iter().enumerate().for_each(|(clip, motion)| of_action[motion.action].push(clip));
            of_action
        };
        let training_of_action = of_action(&data.training);
        if let Some(action) = training_of_action.iter().position(Vec::is_empty) {
            return Err(Error::bad_input(
                "clips",
                format!("action `{}`", data.actions[action]),
                "without clips",
                "at least one clip to train on",
                "add clips of it, or take the action out",
            ));
        }
        let held_out_of_action = of_action(&data.held_out);
        Ok(Self { data, protocol, training_of_action, held_out_of_action })
    }

    /// The clips of the side of the split that a role stands for.
    fn side(&self, role: Role) -> (&'a [RealMotion], &[Vec<usize>]) {
        match role {
            Role::HeldOut => (&self.data.held_out, &self.held_out_of_action),
            _ => (&self.data.training, &self.training_of_action),
        }
    }

    /// The first action that a role has no clip of, where the protocol asks for each.
    pub fn missing_action(&self, role: Role) -> Option<usize> {
        let missing = self.side(role).1.iter().position(Vec::is_empty);
        missing.filter(|_| self.protocol.actions != ActionShares::Data)
    }

    /// Draws the motions of one role in one repetition; none of an action without clips.
    pub fn choose(&self, role: Role, repetition: usize) -> Chosen<'a> {
        let index = role.stream_index(repetition);
        let mut rng = stream(self.protocol.seed, Purpose::Crop, index);
        let (clips, of_action) = self.side(role);
        let indices: Vec<usize> = match self.protocol.actions {
            ActionShares::Data => (0..clips.len()).collect(),
            ActionShares::Uniform { motions_per_action } => of_action
                .iter()
                .filter(|of_action| !of_action.is_empty())
                .flat_map(|of_action| std::iter::repeat_n(of_action, motions_per_action))
                .map(|of_action| of_action[rng.random_range(0..of_action.len())])
                .collect(),
        };
        let clips: Vec<&RealMotion> = indices.iter().map(|&index| &clips[index]).collect();
        let mut draw = |clip: &&RealMotion| {
            (Window::draw(clip.frame_count, self.protocol.frames, &mut rng), rng.random::<u64>())
        };
        let (windows, seeds) = clips.iter().map(&mut draw).unzip();
        Chosen { clips, indices, windows, seeds }
    }

    /// The stream of the pairs of one role in one repetition.
    pub fn pair_stream(&self, role: Role, repetition: usize) -> impl Rng + use<> {
        stream(self.protocol.seed, Purpose::Pairs, role.stream_index(repetition))
    }
}

impl Chosen<'_> {
    /// The data's action of every motion. // (motion)
    pub fn actions(&self) -> Vec<usize> {
        self.clips.iter().map(|clip| clip.action).collect()
    }

    /// The clips themselves in their windows.
    pub fn real_crops(&self, frame_count: usize, data: &RealMotions) -> Crops {
        let channel_count = data.channel_count();
        let mut crops = Crops::new(frame_count, channel_count, data.input);
        for (clip, &window) in self.clips.iter().zip(&self.windows) {
            let frames = window.first..window.first + window.count;
            let poses = frames.start * channel_count..frames.end * channel_count;
            crops.push(window, &clip.positions[poses]);
        }
        crops
    }
}
