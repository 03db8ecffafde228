//! What a tick of the performer costs on a chip, in instructions.
//!
//! In:  what the counter wrote, a region a tick; the program, for what each address is for; the host's ticks.
//! Out: [`InstructionsPerTick`] to `on_chip.rs`.
//!
//! Why here: poses dwarf everything else, so a mean alone says nothing about the loop that must come 50 times a second.
//! Which ticks decode a pose, the kernels' instructions tell; which begin a motion, the host's performer does.

use std::collections::HashMap;

use serde::Serialize;

use super::Tick;
use crate::executable::{Executable, Purpose};
use crate::region_counts::RegionCounts;

/// Instructions of `Player::tick`, by what it has to do; none where no tick was of this kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InstructionsPerTick {
    /// Mean of those between motions or with servos off.
    pub resting: Option<u64>,
    /// Mean of those in a motion that need no new pose: spline, transition, overlays, servo stage.
    pub without_pose: Option<u64>,
    /// The most of both: what the performer itself may cost.
    pub without_pose_max: Option<u64>,
    /// Mean of those that decode a pose, or several where ticks are rarer than frames.
    pub with_pose: Option<u64>,
    /// The most of those that begin a motion, of idling or one that waited: draw a code, fold it, decode a pose. One
    /// that is played at once costs its caller as much, before the tick.
    pub start_max: Option<u64>,
    /// Mean of all.
    pub mean: Option<u64>,
}

impl InstructionsPerTick {
    /// Sorts the ticks.
    pub(super) fn new(regions: &[RegionCounts], ticks: &[Tick], program: &Executable<'_>) -> Self {
        let mut kernels: HashMap<u32, bool> = HashMap::new();
        let mut is_kernel = |address: u32| {
            let known = kernels.entry(address);
            *known.or_insert_with(|| program.purpose(address) == Purpose::Kernel)
        };
        let [mut resting, mut moving, mut decoding, mut starting] = [const { Vec::new() }; 4];
        for (region, tick) in regions.iter().zip(ticks) {
            let kind = if tick.begins_motion {
                &mut starting
            } else if region.addresses.iter().any(|(address, _)| is_kernel(*address)) {
                &mut decoding
            } else if tick.in_motion {
                &mut moving
            } else {
                &mut resting
            };
            kind.push(region.instructions);
        }
        let all: Vec<u64> = regions.iter().map(|region| region.instructions).collect();
        Self {
            resting: mean(&resting),
            without_pose: mean(&moving),
            without_pose_max: resting.iter().chain(&moving).copied().max(),
            with_pose: mean(&decoding),
            start_max: starting.iter().copied().max(),
            mean: mean(&all),
        }
    }
}

/// To the nearest.
fn mean(counts: &[u64]) -> Option<u64> {
    let count = counts.len() as u64;
    (count > 0).then(|| (counts.iter().sum::<u64>() + count / 2) / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_of_no_ticks_is_none_and_others_are_rounded() {
        assert_eq!(mean(&[]), None);
        assert_eq!(mean(&[1, 2]), Some(2));
        assert_eq!(mean(&[1, 1, 2]), Some(1));
    }
}
