//! Which motions prove a blob: every action, short to long, several seeds, whole and fractional positions.
//!
//! In:  a [`Model`].
//! Out: the [`Case`]s that host and device decode.

use karakuri::{ActionId, Model};

use crate::case::Case;

/// Start of the fractional rows of positions, Q16.16 frames; any number that is no simple fraction will do.
const FRACTION_BITS_FIRST: u32 = 0x6a7b;

/// Chooses cases with at least `pose_count_min` positions together, the same for the same model.
pub fn choose_cases(model: &Model<'_>, pose_count_min: usize) -> Vec<Case> {
    let motions: Vec<(u16, u32)> = (0..model.manifest().action_count)
        .flat_map(|action| {
            lengths(model, ActionId(action)).into_iter().map(move |frames| (action, frames))
        })
        .collect();
    let per_motion = pose_count_min.div_ceil(motions.len().max(1)).max(1);
    // As many seeds as positions: both are to vary.
    let seed_count = per_motion.isqrt();
    let pose_count = per_motion.div_ceil(seed_count).min(usize::from(u16::MAX)) as u16;
    motions
        .into_iter()
        .flat_map(|motion| (0..seed_count).map(move |seed| (motion, seed)))
        .enumerate()
        .map(|(index, ((action, frames), seed))| {
            let (first_bits, step_bits) = positions(frames, pose_count, seed % 2 == 1);
            Case { action, pose_count, frames, seed: index as u64, first_bits, step_bits }
        })
        .collect()
}

/// Shortest, middle and longest trained length, each once.
fn lengths(model: &Model<'_>, action: ActionId) -> Vec<u32> {
    let (min, max) = model.trained_frames(action).into_inner();
    // Intervals of lengths may leave gaps between them.
    let is_trained = |&frames: &u32| model.sample(action, frames, &mut || 0).is_ok();
    let middle = (min + (max - min) / 2..=max).find(is_trained).unwrap_or(max);
    let mut lengths = vec![min, middle, max];
    lengths.dedup();
    lengths
}

/// First position and step that spread `pose_count` positions over `frames`, Q16.16; on whole frames or between them.
fn positions(frames: u32, pose_count: u16, fractional: bool) -> (u32, u32) {
    let span_bits = u64::from(frames.saturating_sub(1)) << 16;
    let step_bits = (span_bits / u64::from(pose_count)) as u32;
    if fractional { (FRACTION_BITS_FIRST, step_bits) } else { (0, (step_bits >> 16).max(1) << 16) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    #[test]
    fn cases_cover_every_action_its_lengths_and_fractional_positions() {
        let blob = Fixture::new(1).blob(NumberFormat::W8A16);
        let model = Model::from_bytes(&blob).unwrap();
        for pose_count_min in [1, 7, 1_000] {
            let cases = choose_cases(&model, pose_count_min);
            let pose_count: usize = cases.iter().map(|case| usize::from(case.pose_count)).sum();
            assert!(pose_count >= pose_count_min);
            for motion in [(0, 30), (0, 45), (0, 60), (1, 41), (1, 65), (1, 90)] {
                assert!(
                    cases.iter().any(|case| (case.action, case.frames) == motion),
                    "{motion:?}"
                );
            }
        }
        let cases = choose_cases(&model, 1_000);
        let positions: Vec<u32> = cases
            .iter()
            .flat_map(|case| case.positions().map(|position| position.to_bits()))
            .collect();
        let whole = positions.iter().filter(|bits| *bits & 0xffff == 0).count();
        assert!(whole * 3 > positions.len() && whole * 3 < positions.len() * 2, "{whole}");
    }

    #[test]
    fn positions_stay_within_a_motion_that_has_frames_for_them() {
        for fractional in [false, true] {
            let (first_bits, step_bits) = positions(91, 10, fractional);
            assert!(first_bits + 9 * step_bits <= 90 << 16);
            assert!(first_bits + 9 * step_bits > 80 << 16);
        }
    }
}
