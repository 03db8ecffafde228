//! A clip set → what a user should know before training on it.
//!
//! In:  [`ClipSet`], read with tolerance for non-finite values and missing labels.
//! Out: [`ClipReport`], as text tables or JSON.
//!
//! Why here: a wrong unit, a spike or a label with one clip costs an hour of training to notice and a second to see here.

mod rows;
mod text;

use std::collections::{BTreeMap, HashMap};

use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::clip::ClipSet;
use rows::Row;

/// Fewest clips that make an action: a mixture needs neighbours, and a held-out clip must leave some.
pub const CLIPS_PER_ACTION_MIN: usize = 5;

/// A change between two frames this many times the row's usual largest (99th percentile of the changes that are not 0)
/// is a jump: a tracking error or a cut. In HumanAct12 it finds bodies that leap a metre within a twentieth of a second,
/// in the robot's own moves two twitches in seven minutes.
pub const JUMP_FACTOR: f32 = 8.0;

/// Most places that a report lists one by one; all are counted.
const PLACES_MAX: usize = 10;

/// Everything found.
#[derive(Clone, Debug, Serialize)]
pub struct ClipReport {
    /// Poses per second.
    pub rate_hz: f64,
    /// Number of clips.
    pub clip_count: usize,
    /// Number of poses in all clips.
    pub frame_count: usize,
    /// Shortest, median and longest clip in frames.
    pub frame_counts: Lengths,
    /// The actions, by name; unlabelled clips stand under the empty name.
    pub actions: Vec<ActionReport>,
    /// Number of channels of a pose.
    pub channel_count: usize,
    /// One row per channel, or per group where those are many.
    pub rows: Vec<RowReport>,
    /// Channels that never change, and rotations none of whose elements do.
    pub constant_channels: Vec<String>,
    /// NaN and infinite values: how many, and the first of them.
    pub non_finite: Places,
    /// Frames with changes beyond [`JUMP_FACTOR`]: how many, and the worst row of the worst of them.
    pub jumps: Places,
    /// Names of clips with the same poses.
    pub duplicates: Vec<Vec<String>>,
    /// What the importer had to say.
    pub remarks: Vec<String>,
}

/// Extremes and middle of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Lengths {
    /// Smallest.
    pub min: usize,
    /// Middle; the upper one of two.
    pub median: usize,
    /// Largest.
    pub max: usize,
}

/// One action's share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ActionReport {
    /// Name; empty for clips without a label.
    pub name: String,
    /// Number of its clips.
    pub clip_count: usize,
    /// Lengths of its clips in frames.
    pub frame_counts: Lengths,
    /// Fewer clips than [`CLIPS_PER_ACTION_MIN`].
    pub is_scarce: bool,
}

/// One channel or group over all clips.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RowReport {
    /// The channel's or group's name.
    pub name: String,
    /// Unit of `min` and `max`; degrees for rotations.
    pub unit: String,
    /// Smallest value; for rotations the smallest angle from the identity.
    pub min: f32,
    /// Largest value; for rotations the largest angle from the identity.
    pub max: f32,
    /// Largest change between two frames, times the rate: unit per second; of vectors the length.
    pub speed_max: f32,
    /// Number of values that are not finite.
    pub non_finite_count: usize,
    /// Number of jumps.
    pub jump_count: usize,
}

/// Places in clips.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Places {
    /// Number of all.
    pub count: usize,
    /// The first or worst few.
    pub places: Vec<Place>,
}

/// One value, or one change that leads to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Name of the clip.
    pub clip: String,
    /// Frame in the clip.
    pub frame: usize,
    /// Name of the row.
    pub row: String,
    /// The value (as text, for JSON has no NaN), or the change in the row's unit.
    pub value: String,
}

impl ClipReport {
    /// Looks at every value once per row.
    pub fn new(clip_set: &ClipSet) -> Self {
        let lengths: Vec<usize> = clip_set
            .clips
            .iter()
            .map(|clip| clip.frame_count(&clip_set.layout))
            .collect();
        let analysed: Vec<rows::Analysis> = rows::rows(&clip_set.layout)
            .iter()
            .map(|row: &Row| row.analyse(clip_set))
            .collect();
        let jumps = worst_by_frame(analysed.iter().flat_map(|analysis| analysis.jumps.clone()));
        Self {
            rate_hz: clip_set.rate_hz,
            clip_count: clip_set.clips.len(),
            frame_count: lengths.iter().sum(),
            frame_counts: Lengths::of(lengths.clone()),
            actions: actions(clip_set, &lengths),
            channel_count: clip_set.layout.channel_count(),
            constant_channels: rows::constant_channels(clip_set),
            non_finite: Places {
                count: analysed
                    .iter()
                    .map(|analysis| analysis.report.non_finite_count)
                    .sum(),
                places: rows::first_non_finite(clip_set, PLACES_MAX),
            },
            jumps: Places {
                count: jumps.len(),
                places: jumps
                    .into_iter()
                    .take(PLACES_MAX)
                    .map(|jump| jump.place)
                    .collect(),
            },
            rows: analysed
                .into_iter()
                .map(|analysis| analysis.report)
                .collect(),
            duplicates: duplicates(clip_set),
            remarks: clip_set.remarks.clone(),
        }
    }
}

impl Lengths {
    fn of(mut lengths: Vec<usize>) -> Self {
        lengths.sort_unstable();
        let at = |index: usize| lengths.get(index).copied().unwrap_or(0);
        Self {
            min: at(0),
            median: at(lengths.len() / 2),
            max: at(lengths.len().saturating_sub(1)),
        }
    }
}

fn actions(clip_set: &ClipSet, lengths: &[usize]) -> Vec<ActionReport> {
    let mut by_name: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (clip, length) in clip_set.clips.iter().zip(lengths) {
        by_name.entry(&clip.action).or_default().push(*length);
    }
    by_name
        .into_iter()
        .map(|(name, lengths)| ActionReport {
            name: name.to_string(),
            clip_count: lengths.len(),
            is_scarce: lengths.len() < CLIPS_PER_ACTION_MIN,
            frame_counts: Lengths::of(lengths),
        })
        .collect()
}

/// The worst jump of every frame that has any, worst first: a body that leaps does so with all its joints.
fn worst_by_frame(jumps: impl Iterator<Item = rows::Jump>) -> Vec<rows::Jump> {
    let mut worst: BTreeMap<(String, usize), rows::Jump> = BTreeMap::new();
    for jump in jumps {
        let frame = (jump.place.clip.clone(), jump.place.frame);
        let known = worst.entry(frame).or_insert_with(|| jump.clone());
        if jump.severity > known.severity {
            *known = jump;
        }
    }
    let mut worst: Vec<rows::Jump> = worst.into_values().collect();
    worst.sort_by(|a, b| b.severity.total_cmp(&a.severity));
    worst
}

/// Groups of clips with equal bits, found by a digest of their poses.
fn duplicates(clip_set: &ClipSet) -> Vec<Vec<String>> {
    let mut by_digest: HashMap<_, Vec<String>> = HashMap::new();
    for clip in &clip_set.clips {
        let mut digest = Sha256::new();
        clip.poses
            .iter()
            .for_each(|value| digest.update(value.to_le_bytes()));
        by_digest
            .entry(digest.finalize())
            .or_default()
            .push(clip.name.clone());
    }
    let mut groups: Vec<_> = by_digest
        .into_values()
        .filter(|names| names.len() > 1)
        .collect();
    groups.sort();
    groups
}
