//! Between stations 1 and 1b: which clips training does not see, so that one can ask whether it generalises.
//!
//! In:  [`ClipSet`] of an importer; share and seed of the configuration.
//! Out: training clips and held-out clips, to `represent`.
//!
//! Why here: before anything is measured on the clips (skeleton, mean, scale), so that nothing of a held-out clip
//! reaches a checkpoint but its name, action and length.

use std::collections::BTreeMap;

use rand::seq::SliceRandom;

use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::random::{Purpose, stream};

/// Splits clips into those to train on and those held out; `None` when the share is 0.
///
/// Of every action, `share` of the clips is held out, rounded to nearest; one clip at least stays. The choice depends
/// on the seed and on which clips each action has, and on nothing in them but this: a held-out clip with the very poses
/// of a training clip would be no test, so it goes back to training. (CMU's clips have 60 such pairs.)
///
/// # Errors
/// A share so small that no action has a clip to hold out.
pub fn hold_out(clip_set: ClipSet, share: f64, seed: u64) -> Result<(ClipSet, Option<ClipSet>)> {
    if share == 0.0 {
        return Ok((clip_set, None));
    }
    let mut is_held_out = choose(&clip_set.clips, share, seed);
    let copy_count = give_back_copies(&clip_set.clips, &mut is_held_out);
    if !is_held_out.contains(&true) {
        return Err(Error::bad_input(
            "clips",
            "hold_out",
            share,
            "a share that leaves out a clip of at least one action",
            "hold out a larger share, give actions more clips, or join actions by --label-groups",
        ));
    }
    let mut is_held_out = is_held_out.into_iter();
    let (held_out, training): (Vec<Clip>, Vec<Clip>) =
        clip_set.clips.into_iter().partition(|_| is_held_out.next() == Some(true));
    let mut training = ClipSet { clips: training, ..clip_set };
    if copy_count > 0 {
        training.remarks.push(format!(
            "{copy_count} clips with the poses of a training clip were not held out"
        ));
    }
    let held_out = ClipSet { clips: held_out, remarks: Vec::new(), ..training.clone() };
    Ok((training, Some(held_out)))
}

/// Whether each clip is held out. // (clip)
fn choose(clips: &[Clip], share: f64, seed: u64) -> Vec<bool> {
    let mut clips_of_action: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (index, clip) in clips.iter().enumerate() {
        clips_of_action.entry(&clip.action).or_default().push(index);
    }
    let mut is_held_out = vec![false; clips.len()];
    for (action, mut indices) in (0..).zip(clips_of_action.into_values()) {
        let wanted = (share * indices.len() as f64).round() as usize;
        indices.shuffle(&mut stream(seed, Purpose::HoldOut, action));
        for &index in indices.iter().take(wanted.min(indices.len() - 1)) {
            is_held_out[index] = true;
        }
    }
    is_held_out
}

/// Takes clips back into training that have the poses of a clip there; how many.
fn give_back_copies(clips: &[Clip], is_held_out: &mut [bool]) -> usize {
    let training: Vec<&Clip> =
        clips.iter().zip(&*is_held_out).filter(|(_, out)| !**out).map(|(clip, _)| clip).collect();
    let mut copy_count = 0;
    for (clip, is_held_out) in clips.iter().zip(is_held_out) {
        let is_copy = |other: &&Clip| !clip.poses.is_empty() && other.poses == clip.poses;
        if *is_held_out && training.iter().any(is_copy) {
            *is_held_out = false;
            copy_count += 1;
        }
    }
    copy_count
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::layout::PoseLayout;

    /// Clips whose only content is name and action, in order of name.
    fn clip_set(clip_counts: &[usize]) -> ClipSet {
        let clip = |action: usize, number: usize| Clip {
            name: format!("{number}-of-{action}"),
            action: format!("action{action}"),
            source: "memory".into(),
            poses: Vec::new(),
        };
        let clips = clip_counts.iter().enumerate();
        let mut clips: Vec<Clip> =
            clips.flat_map(|(action, &count)| (0..count).map(move |n| clip(action, n))).collect();
        clips.sort_by(|a, b| a.name.cmp(&b.name));
        ClipSet {
            layout: PoseLayout::default(),
            rate_hz: 50.0,
            skeleton: None,
            clips,
            remarks: Vec::new(),
        }
    }

    fn names(clip_set: &ClipSet) -> Vec<String> {
        clip_set.clips.iter().map(|clip| clip.name.clone()).collect()
    }

    #[test]
    fn share_that_holds_out_nothing_is_refused() {
        for clip_counts in [vec![1, 1, 1], vec![4, 4]] {
            let message = hold_out(clip_set(&clip_counts), 0.1, 1).unwrap_err().to_string();
            assert!(message.contains("hold_out is 0.1"), "{message}");
            assert!(message.contains("larger share"), "{message}");
        }
    }

    #[test]
    fn share_of_zero_changes_nothing() {
        let set = clip_set(&[3, 2]);
        assert_eq!(hold_out(set.clone(), 0.0, 1).unwrap(), (set, None));
    }

    #[test]
    fn copies_of_training_clips_are_not_held_out() {
        let mut set = clip_set(&[10]);
        for (index, clip) in set.clips.iter_mut().enumerate() {
            clip.poses = vec![(index / 2) as f32; 4]; // Five pairs.
        }
        let (training, held_out) = hold_out(set, 0.5, 1).unwrap();
        let held_out = held_out.unwrap();
        assert!(!held_out.clips.is_empty());
        let is_trained = |clip: &Clip| training.clips.iter().any(|other| other.poses == clip.poses);
        assert!(!held_out.clips.iter().any(is_trained));
        assert_eq!(training.clips.len() + held_out.clips.len(), 10);
        assert!(training.remarks[0].contains("were not held out"), "{:?}", training.remarks);
    }

    #[test]
    fn another_seed_chooses_other_clips() {
        let chosen = |seed| {
            let (_, held_out) = hold_out(clip_set(&[40]), 0.5, seed).unwrap();
            names(&held_out.unwrap())
        };
        assert_ne!(chosen(1), chosen(2));
    }

    proptest! {
        #[test]
        fn split_is_disjoint_complete_stratified_and_deterministic(
            clip_counts in prop::collection::vec(1_usize..30, 1..8),
            share in 0.01..0.99_f64,
            seed: u64,
        ) {
            let set = clip_set(&clip_counts);
            let Ok((training, held_out)) = hold_out(set.clone(), share, seed) else {
                prop_assert!(clip_counts.iter().all(|&n| n == 1 || share * (n as f64) < 0.5));
                return Ok(());
            };
            let held_out = held_out.unwrap();
            let again = hold_out(set.clone(), share, seed).unwrap();
            prop_assert_eq!(&again, &(training.clone(), Some(held_out.clone())));
            prop_assert!(names(&training).is_sorted() && names(&held_out).is_sorted());
            let mut all = [names(&training), names(&held_out)].concat();
            all.sort();
            prop_assert_eq!(all, names(&set));
            for (action, &count) in clip_counts.iter().enumerate() {
                let action = format!("action{action}");
                let left_out = held_out.clips.iter().filter(|c| c.action == action).count();
                let exact = share * count as f64;
                prop_assert!(left_out < count);
                prop_assert!(left_out == count - 1 || (left_out as f64 - exact).abs() <= 0.5);
            }
        }
    }
}
