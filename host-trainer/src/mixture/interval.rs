//! Between stations 4 and 5: which clips stand for which durations.
//!
//! In:  [`DatasetDescription`] (actions and lengths of the clips).
//! Out: [`Interval`]s, to `fit` and to the device's sampler.
//!
//! Why here: the decoder knows a clip only up to its last frame, so a code must come from clips
//! about as long as the motion asked for.
//!
//! Source: Cervantes et al., ECCV 2022, Algorithm 1; differences from it, and from its published
//! code:
//! * Population is counted in clips \[ours\]. \[published code\] counts 50 draws of every clip, so
//!   that its minimum of 50 is one clip.
//! * The window is closed at both ends, `frames_min <= frames <= frames_max` \[ours\]. \[published
//!   code\] takes `start < frames <= end`, which leaves out every clip of exactly the least length
//!   and fails on an action whose clips are all equally long.
//! * Intervals share no length and leave none out \[ours\], and serve exactly the lengths that they
//!   contain. \[published code\] serves a length from the nearest centre, 33 of 261 lengths from an
//!   interval that does not contain them.
//! * The longest clips may be too few for an interval. \[paper\] lets that window grow upward,
//!   where no clips are; \[published code\] lets it grow downward, so that intervals overlap. Here
//!   its population grows downward and the lengths that it serves stay as they are.

use crate::dataset::DatasetDescription;

/// Durations of one action that share a population of clips.
///
/// Intervals of one action are disjoint and in order, and leave no gap from its shortest to its
/// longest clip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interval {
    /// Index into the dataset's actions.
    pub action: usize,
    /// Least number of poses served.
    pub frames_min: usize,
    /// Greatest number of poses served, inclusive.
    pub frames_max: usize,
    /// Rows of the code table, ascending in length; never empty.
    ///
    /// Every clip within the lengths served, and in the last interval of an action also shorter
    /// ones.
    pub clips: Vec<usize>,
}

/// The least size of an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IntervalSize {
    /// Number of lengths. Source: 10 in the published code; the paper names none.
    pub frames_min: usize,
    /// Number of clips; an action with fewer has one interval with all of them.
    pub clips_min: usize,
}

/// Divides the lengths of every action into intervals, action by action.
///
/// An action without clips has no interval.
pub fn build_intervals(description: &DatasetDescription, size: IntervalSize) -> Vec<Interval> {
    (0..description.actions.len())
        .flat_map(|action| build_intervals_of_action(description, action, size))
        .collect()
}

fn build_intervals_of_action(
    description: &DatasetDescription,
    action: usize,
    size: IntervalSize,
) -> Vec<Interval> {
    let clips = clips_by_length(description, action);
    let mut intervals = Vec::new();
    let mut first = 0;
    let mut frames_min = clips.first().map_or(0, |clip| clip.frame_count);
    while first < clips.len() {
        let frames_max = grow_upward(&clips, first, frames_min, size);
        let end = clips.partition_point(|clip| clip.frame_count <= frames_max);
        let population_first = match end == clips.len() {
            true => grow_downward(&clips, first, size),
            false => first,
        };
        intervals.push(Interval {
            action,
            frames_min,
            frames_max,
            clips: clips[population_first..end].iter().map(|clip| clip.row).collect(),
        });
        first = end;
        frames_min = frames_max + 1;
    }
    intervals
}

struct ClipLength {
    row: usize,
    frame_count: usize,
}

fn clips_by_length(description: &DatasetDescription, action: usize) -> Vec<ClipLength> {
    let mut clips: Vec<ClipLength> = description
        .clips
        .iter()
        .enumerate()
        .filter(|(_, clip)| clip.action == action)
        .map(|(row, clip)| ClipLength { row, frame_count: clip.frame_count })
        .collect();
    clips.sort_by_key(|clip| clip.frame_count);
    clips
}

/// Greatest length of the smallest window from `frames_min` that is large enough, or of the action.
fn grow_upward(clips: &[ClipLength], first: usize, frames_min: usize, size: IntervalSize) -> usize {
    let longest = clips[clips.len() - 1].frame_count;
    let last_wanted = first.saturating_add(size.clips_min.max(1)) - 1;
    match clips.get(last_wanted) {
        Some(clip) => {
            let wide_enough = frames_min.saturating_add(size.frames_min.max(1)) - 1;
            clip.frame_count.max(wide_enough).min(longest)
        }
        None => longest,
    }
}

/// First clip of the smallest window up to the longest clip that is large enough; at most `first`.
fn grow_downward(clips: &[ClipLength], first: usize, size: IntervalSize) -> usize {
    let longest = clips[clips.len() - 1].frame_count;
    let wide_enough = longest.saturating_add(1).saturating_sub(size.frames_min.max(1));
    let last_unwanted = clips.len().saturating_sub(size.clips_min.max(1));
    let window_min = clips[last_unwanted.min(first)].frame_count.min(wide_enough);
    first.min(clips.partition_point(|clip| clip.frame_count < window_min))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::dataset::ClipDescription;
    use crate::layout::PoseLayout;

    const SIZE: IntervalSize = IntervalSize { frames_min: 10, clips_min: 3 };

    fn description(lengths: &[(usize, usize)]) -> DatasetDescription {
        let action_count = lengths.iter().map(|&(action, _)| action + 1).max();
        DatasetDescription {
            layout: PoseLayout::default(),
            rate_hz: 20.0,
            actions: (0..action_count.unwrap_or(0)).map(|i| format!("a{i}")).collect(),
            clips: lengths
                .iter()
                .enumerate()
                .map(|(row, &(action, frame_count))| ClipDescription {
                    name: format!("clip{row}"),
                    action,
                    frame_count,
                })
                .collect(),
            held_out: Vec::new(),
            mean: Vec::new(),
            scale: Vec::new(),
            skeleton: None,
        }
    }

    fn intervals_of_lengths(lengths: &[usize]) -> Vec<Interval> {
        let clips: Vec<_> = lengths.iter().map(|&frames| (0, frames)).collect();
        build_intervals(&description(&clips), SIZE)
    }

    #[test]
    fn dataset_without_clips_has_no_intervals() {
        assert_eq!(build_intervals(&description(&[]), SIZE), []);
    }

    #[test]
    fn action_without_clips_has_no_interval() {
        let intervals = build_intervals(&description(&[(1, 30)]), SIZE);
        assert_eq!(intervals.len(), 1);
        assert_eq!(intervals[0].action, 1);
    }

    #[test]
    fn one_clip_makes_one_interval_of_its_own_length() {
        let expected = Interval { action: 0, frames_min: 30, frames_max: 30, clips: vec![0] };
        assert_eq!(intervals_of_lengths(&[30]), [expected]);
    }

    #[test]
    fn action_of_equal_lengths_makes_one_interval_with_all_clips() {
        let intervals = intervals_of_lengths(&[25; 7]);
        assert_eq!(intervals.len(), 1);
        assert_eq!((intervals[0].frames_min, intervals[0].frames_max), (25, 25));
        assert_eq!(intervals[0].clips.len(), 7);
    }

    #[test]
    fn window_grows_until_it_is_wide_and_populated_enough() {
        let intervals = intervals_of_lengths(&[10, 11, 12, 13, 40, 41, 60]);
        let ranges: Vec<_> =
            intervals.iter().map(|interval| (interval.frames_min, interval.frames_max)).collect();
        assert_eq!(ranges, [(10, 19), (20, 60)]);
        assert_eq!(intervals[1].clips, [4, 5, 6]);
    }

    #[test]
    fn last_interval_fills_its_population_with_shorter_clips() {
        let intervals = intervals_of_lengths(&[10, 15, 19, 90]);
        assert_eq!((intervals[1].frames_min, intervals[1].frames_max), (20, 90));
        assert_eq!(intervals[1].clips, [1, 2, 3]);
    }

    #[test]
    fn last_interval_that_is_too_narrow_widens_its_population_only() {
        let intervals = intervals_of_lengths(&[10, 17, 19, 21, 21, 21]);
        assert_eq!((intervals[1].frames_min, intervals[1].frames_max), (20, 21));
        assert_eq!(intervals[1].clips, [1, 2, 3, 4, 5]);
    }

    proptest! {
        #[test]
        fn intervals_partition_the_lengths_of_every_action(
            lengths in prop::collection::vec((0usize..3, 1usize..400), 1..120),
            frames_min in 0usize..40,
            clips_min in 0usize..20,
        ) {
            let description = description(&lengths);
            let size = IntervalSize { frames_min, clips_min };
            let intervals = build_intervals(&description, size);
            for action in 0..description.actions.len() {
                let of_action: Vec<_> =
                    intervals.iter().filter(|interval| interval.action == action).collect();
                let frames = lengths.iter().filter(|clip| clip.0 == action).map(|clip| clip.1);
                prop_assert_eq!(of_action.first().map(|i| i.frames_min), frames.clone().min());
                prop_assert_eq!(of_action.last().map(|i| i.frames_max), frames.max());
                for pair in of_action.windows(2) {
                    prop_assert_eq!(pair[0].frames_max + 1, pair[1].frames_min);
                    prop_assert!(pair[0].frames_max + 1 - pair[0].frames_min >= frames_min);
                }
            }
        }

        #[test]
        fn every_clip_is_in_the_interval_of_its_length_and_populations_suffice(
            lengths in prop::collection::vec((0usize..3, 1usize..400), 1..120),
            frames_min in 0usize..40,
            clips_min in 0usize..20,
        ) {
            let size = IntervalSize { frames_min, clips_min };
            let intervals = build_intervals(&description(&lengths), size);
            for (row, &(action, frames)) in lengths.iter().enumerate() {
                let serving = intervals.iter().find(|interval| {
                    interval.action == action
                        && (interval.frames_min..=interval.frames_max).contains(&frames)
                });
                prop_assert!(serving.is_some_and(|interval| interval.clips.contains(&row)));
            }
            for interval in &intervals {
                let rows = &interval.clips;
                let of_action = lengths.iter().filter(|clip| clip.0 == interval.action).count();
                prop_assert!(rows.len() >= clips_min.min(of_action).max(1));
                prop_assert!(rows.iter().all(|&row| lengths[row].0 == interval.action));
                prop_assert!(rows.is_sorted_by_key(|&row| (lengths[row].1, row)));
                prop_assert!(rows.windows(2).all(|pair| pair[0] != pair[1]));
            }
        }
    }
}
