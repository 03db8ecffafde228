//! A clip set → what a user should know before training on it.
//!
//! In:  [`ClipSet`], read with tolerance for non-finite values and missing labels.
//! Out: [`ClipReport`], as text tables or JSON.
//!
//! Why here: a wrong unit, a spike or a label with one clip costs an hour of training to notice and
//! a second to see here.

pub mod blob;

mod rows;
mod text;

use std::collections::{BTreeMap, HashMap};

use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::clip::ClipSet;
use rows::Row;

/// Fewest clips that make an action: a mixture needs neighbours, and a held-out clip must leave
/// some.
pub const CLIPS_PER_ACTION_MIN: usize = 5;

/// A change between two frames this many times the row's usual largest (99th percentile of the
/// changes that are not 0) is a jump: a tracking error or a cut. In HumanAct12 it finds bodies that
/// leap a metre within a twentieth of a second, in the robot's own moves two twitches in seven
/// minutes.
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
    /// Frames with changes beyond [`JUMP_FACTOR`]: how many, and the worst row of the worst of
    /// them.
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
        let lengths: Vec<usize> =
            clip_set.clips.iter().map(|clip| clip.frame_count(&clip_set.layout)).collect();
        let analysed: Vec<rows::Analysis> =
            rows::rows(&clip_set.layout).iter().map(|row: &Row| row.analyse(clip_set)).collect();
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
                count: analysed.iter().map(|analysis| analysis.report.non_finite_count).sum(),
                places: rows::first_non_finite(clip_set, PLACES_MAX),
            },
            jumps: Places {
                count: jumps.len(),
                places: jumps.into_iter().take(PLACES_MAX).map(|jump| jump.place).collect(),
            },
            rows: analysed.into_iter().map(|analysis| analysis.report).collect(),
            duplicates: duplicates(clip_set),
            remarks: clip_set.remarks.clone(),
        }
    }
}

impl Lengths {
    fn of(mut lengths: Vec<usize>) -> Self {
        lengths.sort_unstable();
        let at = |index: usize| lengths.get(index).copied().unwrap_or(0);
        Self { min: at(0), median: at(lengths.len() / 2), max: at(lengths.len().saturating_sub(1)) }
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

/// The worst jump of every frame that has any, worst first: a body that leaps does so with all its
/// joints.
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
        clip.poses.iter().for_each(|value| digest.update(value.to_le_bytes()));
        by_digest.entry(digest.finalize()).or_default().push(clip.name.clone());
    }
    let mut groups: Vec<_> = by_digest.into_values().filter(|names| names.len() > 1).collect();
    groups.sort();
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clip::Clip;
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};

    fn scalars(names: &[&str]) -> PoseLayout {
        let group = |name: &&str| Group {
            name: name.to_string(),
            kind: GroupKind::Scalar,
            unit: Unit::Degree,
        };
        PoseLayout { groups: names.iter().map(group).collect() }
    }

    fn clip(name: &str, action: &str, poses: Vec<f32>) -> Clip {
        Clip { name: name.into(), action: action.into(), source: name.into(), poses }
    }

    fn set(layout: PoseLayout, clips: Vec<Clip>) -> ClipSet {
        ClipSet { layout, rate_hz: 50.0, skeleton: None, clips, remarks: Vec::new() }
    }

    /// A ramp of 1 degree a frame beside a constant.
    fn ramp(frame_count: usize) -> Vec<f32> {
        (0..frame_count).flat_map(|frame| [frame as f32, 7.0]).collect()
    }

    fn report(clips: Vec<Clip>) -> ClipReport {
        ClipReport::new(&set(scalars(&["jaw", "lid"]), clips))
    }

    #[test]
    fn empty_set_is_reported_without_panic() {
        let report = report(Vec::new());
        assert_eq!((report.clip_count, report.frame_counts.max), (0, 0));
        assert!(report.to_string().contains("0 clips"));
    }

    #[test]
    fn non_finite_values_are_counted_and_placed() {
        let mut poses = ramp(20);
        poses[6] = f32::NAN;
        poses[11] = f32::INFINITY;
        let report = report(vec![clip("a", "nod", poses)]);
        assert_eq!(report.non_finite.count, 2);
        let place = &report.non_finite.places[0];
        assert_eq!((place.clip.as_str(), place.frame, place.row.as_str()), ("a", 3, "jaw_deg"));
        assert_eq!(report.rows[0].max, 19.0);
        assert!(report.to_string().contains("a frame 5, lid_deg: inf"));
    }

    #[test]
    fn leap_of_all_channels_is_one_jump() {
        let mut poses: Vec<f32> = (0..400).map(|i| (i / 2) as f32).collect();
        poses[300..].iter_mut().for_each(|value| *value += 20.0);
        let report = report(vec![clip("a", "nod", poses)]);
        assert_eq!((report.jumps.count, report.jumps.places[0].frame), (1, 150));
        assert_eq!((report.rows[0].jump_count, report.rows[1].jump_count), (1, 1));
    }

    #[test]
    fn servo_that_rests_most_of_the_time_does_not_jump() {
        let mut poses = vec![0.0; 2000];
        for (i, value) in poses.iter_mut().step_by(2).enumerate() {
            *value = (i as f32 - 990.0).max(0.0);
        }
        assert_eq!(report(vec![clip("a", "nod", poses)]).jumps.count, 0);
    }

    #[test]
    fn range_speed_and_constant_channels_are_found() {
        let report = report(vec![clip("a", "nod", ramp(20)), clip("b", "nod", ramp(5))]);
        let row = &report.rows[0];
        assert_eq!((row.min, row.max, row.speed_max), (0.0, 19.0, 50.0));
        assert_eq!(report.constant_channels, ["lid_deg"]);
        assert_eq!(report.frame_counts, Lengths { min: 5, median: 20, max: 20 });
    }

    #[test]
    fn same_poses_under_two_names_are_found() {
        let clips =
            ["a", "b", "c"].map(|name| clip(name, "nod", ramp(if name == "b" { 9 } else { 5 })));
        assert_eq!(report(clips.to_vec()).duplicates, [["a", "c"]]);
    }

    #[test]
    fn scarce_actions_and_missing_labels_are_found() {
        let mut clips: Vec<Clip> =
            (0..5).map(|i| clip(&format!("nod{i}"), "nod", ramp(5 + i))).collect();
        clips.push(clip("bow", "bow", ramp(11)));
        clips.push(clip("what", "", ramp(12)));
        let report = report(clips);
        let scarce: Vec<_> =
            report.actions.iter().map(|action| (action.name.as_str(), action.is_scarce)).collect();
        assert_eq!(scarce, [("", true), ("bow", true), ("nod", false)]);
        let text = report.to_string();
        assert!(text.contains("1 clips have no label"), "{text}");
        assert!(text.contains("1 actions have fewer than 5 clips"), "{text}");
    }

    #[test]
    fn rotations_are_reported_in_degrees() {
        let layout = PoseLayout {
            groups: vec![Group {
                name: "head".into(),
                kind: GroupKind::Rotation6d,
                unit: Unit::One,
            }],
        };
        let quarter = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0];
        let poses = [[1.0, 0.0, 0.0, 0.0, 1.0, 0.0], quarter].concat();
        let report = ClipReport::new(&set(layout, vec![clip("a", "nod", poses)]));
        let row = &report.rows[0];
        assert_eq!((row.name.as_str(), row.unit.as_str()), ("head", "deg"));
        assert!((row.max - 90.0).abs() < 1e-3 && (row.speed_max - 4500.0).abs() < 0.1);
    }

    #[test]
    fn report_is_json_even_with_nan() {
        let report = report(vec![clip("a", "nod", vec![f32::NAN; 8])]);
        let json: serde_json::Value =
            serde_json::from_str(&serde_json::to_string(&report).unwrap()).unwrap();
        assert_eq!(json["non_finite"]["places"][0]["value"], "NaN");
        assert_eq!(json["rows"][0]["non_finite_count"], 4);
    }

    #[test]
    fn text_of_a_small_set_reads_well() {
        let clips = vec![clip("a", "nod", ramp(20)), clip("b", "nod", ramp(5))];
        let expected = "\
2 clips, 1 actions, 25 frames, 0.5 s at 50 Hz, 2 channels

action  clips  frames min  median  max  s min  median   max
nod         2           5      20   20   0.10    0.40  0.40
all         2           5      20   20   0.10    0.40  0.40

channel  unit    min     max  max speed /s  jumps  non-finite
jaw_deg   deg  0.000  19.000        50.000      0           0
lid_deg   deg  7.000   7.000         0.000      0           0

warnings
  1 actions have fewer than 5 clips; --label-groups can join them: nod (2)
  constant: lid_deg
";
        assert_eq!(report(clips).to_string(), expected);
    }
}
