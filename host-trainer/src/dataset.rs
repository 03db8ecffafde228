//! Station 2: standardised training pairs.
//!
//! In:  [`ClipSet`](crate::clip::ClipSet) in its training representation.
//! Out: [`Dataset`] to `train`; its [`DatasetDescription`] lives on in the checkpoint and in the
//! blob.
//!
//! Why one scale a kind: the loss is a mean of squares over all channels. Rotations share a scale,
//! and positions share one, so that a joint that moves little keeps its small weight instead of
//! having its noise blown up to a joint's full weight; a translation and a servo are quantities of
//! their own and get their own.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::body::skeleton::Skeleton;
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout};

/// What a checkpoint has to remember of its dataset: everything except the poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetDescription {
    /// Meaning of the channels.
    pub layout: PoseLayout,
    /// Poses per second.
    pub rate_hz: f64,
    /// Names of the actions, sorted; an action's index is its `ActionId`.
    pub actions: Vec<String>,
    /// The clips, in training order: row i of the code table belongs to clip i.
    pub clips: Vec<ClipDescription>,
    /// Clips of the same source that training does not see; what is known of them here is all that is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_out: Vec<ClipDescription>,
    /// Per channel: value that becomes 0. // (channel)
    pub mean: Vec<f32>,
    /// Per channel: units per 1 of the standardised value; never 0. // (channel)
    pub scale: Vec<f32>,
    /// The joint tree, if any; offsets are the mean bone lengths over the clips.
    pub skeleton: Option<Skeleton>,
}

/// One clip of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClipDescription {
    /// The clip's name.
    pub name: String,
    /// Index into `actions`.
    pub action: usize,
    /// Number of poses.
    pub frame_count: usize,
}

/// Standardised poses of all clips.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Everything but the poses.
    pub description: DatasetDescription,
    /// `(value - mean) / scale`, clip after clip. // (frame of all clips, channel)
    pub poses: Vec<f32>,
    /// Row of each clip's first pose in `poses`. // (clip)
    pub first_rows: Vec<usize>,
}

/// How channels are brought to a common size before training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Standardization {
    /// Minus the channel's mean, divided by the standard deviation of its kind of group.
    #[default]
    Group,
    /// The channel values as they are, as in the published code: mean 0, scale 1.
    None,
}

/// What [`build`] needs to know besides the clips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DatasetOptions {
    /// How channels are brought to a common size.
    pub standardization: Standardization,
}

/// A constant channel's scale, relative to its value: so small that f32 output rounds to the
/// constant itself.
const CONSTANT_CHANNEL_SCALE: f32 = 1e-9;

/// Puts the clips in training order and standardises them.
///
/// Sums are accumulated in f64. A channel that never changes gets a scale of 1e-9 of its value (at
/// least 1e-9 units): it trains to 0 and comes back as the constant.
///
/// # Errors
/// - No clips at all.
/// - A clip without an action, with fewer than two poses, or with a value that is not finite.
pub fn build(clip_set: &ClipSet, options: &DatasetOptions) -> Result<Dataset> {
    if clip_set.clips.is_empty() {
        return Err(Error::bad_input(
            "clips",
            "number of clips",
            0,
            "at least 1",
            "name a folder that holds clips",
        ));
    }
    for clip in &clip_set.clips {
        check_clip(clip, &clip_set.layout)?;
    }
    let mut actions: Vec<String> = clip_set.clips.iter().map(|c| c.action.clone()).collect();
    actions.sort();
    actions.dedup();
    let (mean, scale) = match options.standardization {
        Standardization::Group => mean_and_scale(clip_set),
        Standardization::None => {
            let channel_count = clip_set.layout.channel_count();
            (vec![0.0; channel_count], vec![1.0; channel_count])
        }
    };
    let description = DatasetDescription {
        layout: clip_set.layout.clone(),
        rate_hz: clip_set.rate_hz,
        clips: describe_clips(clip_set, &actions),
        held_out: Vec::new(),
        actions,
        mean,
        scale,
        skeleton: clip_set.skeleton.clone(),
    };
    Ok(standardized(clip_set, description))
}

/// Puts clips that training does not see on the footing of those that it does, and notes them in `training`.
///
/// A channel that is constant in `training` is taken for constant here too.
///
/// # Errors
/// - A clip without an action, with fewer than two poses, or with a value that is not finite.
/// - An action that no training clip shows.
pub fn build_held_out(clip_set: &ClipSet, training: &mut Dataset) -> Result<Dataset> {
    let actions = &training.description.actions;
    for clip in &clip_set.clips {
        check_clip(clip, &clip_set.layout)?;
        if !actions.contains(&clip.action) {
            return Err(Error::bad_input(
                &clip.source,
                "action",
                &clip.action,
                format!("one of {}", actions.join(", ")),
                "hold out only clips of actions that are trained",
            ));
        }
    }
    let clips = describe_clips(clip_set, actions);
    training.description.held_out.clone_from(&clips);
    let description =
        DatasetDescription { clips, held_out: Vec::new(), ..training.description.clone() };
    Ok(standardized(clip_set, description))
}

fn standardized(clip_set: &ClipSet, description: DatasetDescription) -> Dataset {
    let first_rows = description
        .clips
        .iter()
        .scan(0, |next, clip| {
            let row = *next;
            *next += clip.frame_count;
            Some(row)
        })
        .collect();
    let mut poses: Vec<f32> =
        Vec::with_capacity(clip_set.clips.iter().map(|c| c.poses.len()).sum());
    for clip in &clip_set.clips {
        poses.extend_from_slice(&clip.poses);
    }
    description.standardize(&mut poses);
    Dataset { description, poses, first_rows }
}

fn check_clip(clip: &Clip, layout: &PoseLayout) -> Result<()> {
    if clip.action.trim().is_empty() {
        return Err(Error::bad_input(
            &clip.source,
            "action",
            "missing",
            "a label for every clip",
            "give labels with --labels, --label-from or folder names, or leave the file out",
        ));
    }
    let frame_count = clip.frame_count(layout);
    if frame_count < 2 || frame_count * layout.channel_count() != clip.poses.len() {
        return Err(Error::bad_input(
            &clip.source,
            format!("clip {}", clip.name),
            format!("{frame_count} frames ({} values)", clip.poses.len()),
            format!("2 frames or more of {} channels", layout.channel_count()),
            "remove the clip or record it again",
        ));
    }
    if let Some(index) = clip.poses.iter().position(|value| !value.is_finite()) {
        let (frame, channel) = (index / layout.channel_count(), index % layout.channel_count());
        return Err(Error::bad_input(
            &clip.source,
            format!("frame {frame}, channel {}", layout.channel_names()[channel]),
            clip.poses[index],
            "a finite number",
            "repair or remove the clip",
        ));
    }
    Ok(())
}

fn describe_clips(clip_set: &ClipSet, actions: &[String]) -> Vec<ClipDescription> {
    clip_set
        .clips
        .iter()
        .map(|clip| ClipDescription {
            name: clip.name.clone(),
            action: actions.partition_point(|action| *action < clip.action),
            frame_count: clip.frame_count(&clip_set.layout),
        })
        .collect()
}

/// What is known of one channel over all frames.
#[derive(Clone, Copy)]
struct ChannelStatistics {
    mean: f64,
    variance: f64,
    is_constant: bool,
}

fn channel_statistics(clip_set: &ClipSet, channel: usize) -> ChannelStatistics {
    let channel_count = clip_set.layout.channel_count();
    let values = || {
        clip_set.clips.iter().flat_map(move |clip| {
            clip.poses.iter().skip(channel).step_by(channel_count).map(|value| f64::from(*value))
        })
    };
    let count = values().count() as f64;
    let mean = values().sum::<f64>() / count;
    let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let (min, max) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| {
        (min.min(value), max.max(value))
    });
    // A few units of the last place of f32 are rounding of a constant, not motion.
    let is_constant = max - min <= 4.0 * f64::from(f32::EPSILON) * min.abs().max(max.abs());
    ChannelStatistics { mean, variance, is_constant }
}

/// Mean and scale of every channel. // (channel), (channel)
fn mean_and_scale(clip_set: &ClipSet) -> (Vec<f32>, Vec<f32>) {
    let layout = &clip_set.layout;
    let statistics: Vec<ChannelStatistics> =
        (0..layout.channel_count()).map(|channel| channel_statistics(clip_set, channel)).collect();
    let mut scale = vec![0.0; statistics.len()];
    for channels in scale_families(layout) {
        let moving: Vec<f64> = channels
            .iter()
            .filter(|channel| !statistics[**channel].is_constant)
            .map(|channel| statistics[*channel].variance)
            .collect();
        let shared = (moving.iter().sum::<f64>() / moving.len().max(1) as f64).sqrt();
        for channel in channels {
            let ChannelStatistics { mean, is_constant, .. } = statistics[channel];
            let constant = constant_scale(mean as f32);
            scale[channel] = if is_constant { constant } else { shared as f32 };
        }
    }
    (statistics.iter().map(|s| s.mean as f32).collect(), scale)
}

/// Sets of channels that share a scale.
fn scale_families(layout: &PoseLayout) -> Vec<Vec<usize>> {
    let of_kind = |kind: GroupKind| {
        layout.ranges().filter(move |(group, _)| group.kind == kind).map(|(_, range)| range)
    };
    let shared = |kind| of_kind(kind).flatten().collect::<Vec<usize>>();
    let own = |kind| of_kind(kind).map(Range::collect::<Vec<usize>>);
    let mut families = vec![shared(GroupKind::Rotation6d), shared(GroupKind::Position)];
    families.extend(own(GroupKind::Translation));
    families.extend(own(GroupKind::Scalar));
    families
}

/// Scale of a channel that never changes.
fn constant_scale(mean: f32) -> f32 {
    CONSTANT_CHANNEL_SCALE * mean.abs().max(1.0)
}

impl DatasetDescription {
    /// Whether the channel had one value in all clips; it standardises to 0 and comes back as that
    /// value.
    pub fn is_constant(&self, channel: usize) -> bool {
        self.scale[channel] <= constant_scale(self.mean[channel])
    }

    /// Channel values to standardised values, in place. // (frame, channel)
    pub fn standardize(&self, poses: &mut [f32]) {
        for pose in poses.chunks_exact_mut(self.mean.len().max(1)) {
            for (channel, value) in pose.iter_mut().enumerate() {
                *value = if self.is_constant(channel) {
                    0.0 // Rounding noise divided by a tiny scale would be a large number.
                } else {
                    (*value - self.mean[channel]) / self.scale[channel]
                };
            }
        }
    }

    /// Standardised values back to channel values, in place. // (frame, channel)
    pub fn destandardize(&self, poses: &mut [f32]) {
        for pose in poses.chunks_exact_mut(self.mean.len().max(1)) {
            for ((value, mean), scale) in pose.iter_mut().zip(&self.mean).zip(&self.scale) {
                *value = *value * scale + mean;
            }
        }
    }
}

impl Dataset {
    /// Standardised poses of one clip. // (frame, channel)
    pub fn clip_poses(&self, clip: usize) -> &[f32] {
        let channel_count = self.description.layout.channel_count();
        let start = self.first_rows[clip];
        let end = start + self.description.clips[clip].frame_count;
        &self.poses[start * channel_count..end * channel_count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Group, Unit};
    use proptest::prelude::*;

    fn layout(kinds: &[GroupKind]) -> PoseLayout {
        let groups = kinds
            .iter()
            .enumerate()
            .map(|(index, kind)| Group { name: format!("g{index}"), kind: *kind, unit: Unit::One })
            .collect();
        PoseLayout { groups }
    }

    fn clip_set(kinds: &[GroupKind], clips: &[(&str, &str, Vec<f32>)]) -> ClipSet {
        let clips = clips
            .iter()
            .map(|(name, action, poses)| Clip {
                name: (*name).to_owned(),
                action: (*action).to_owned(),
                source: format!("{name}.csv").into(),
                poses: poses.clone(),
            })
            .collect();
        ClipSet { layout: layout(kinds), rate_hz: 50.0, skeleton: None, clips, remarks: Vec::new() }
    }

    const TWO_SCALARS: [GroupKind; 2] = [GroupKind::Scalar, GroupKind::Scalar];

    fn refusal(clip_set: &ClipSet) -> String {
        build(clip_set, &DatasetOptions::default()).unwrap_err().to_string()
    }

    #[test]
    fn empty_set_is_refused() {
        assert!(refusal(&clip_set(&TWO_SCALARS, &[])).contains("number of clips is 0"));
    }

    #[test]
    fn clip_of_one_frame_is_refused_by_name() {
        let error = refusal(&clip_set(&TWO_SCALARS, &[("nod3", "nod", vec![0.0; 2])]));
        assert!(error.contains("nod3.csv") && error.contains("1 frames"), "{error}");
    }

    #[test]
    fn clip_without_a_label_is_refused_with_the_remedy() {
        let error = refusal(&clip_set(&TWO_SCALARS, &[("nod3", "", vec![0.0; 4])]));
        assert!(error.contains("nod3.csv") && error.contains("--labels"), "{error}");
    }

    #[test]
    fn value_that_is_not_finite_is_refused_by_frame_and_channel() {
        let poses = vec![0.0, 1.0, 2.0, f32::NAN];
        let error = refusal(&clip_set(&TWO_SCALARS, &[("nod3", "nod", poses)]));
        assert!(error.contains("frame 1, channel g1_one is NaN"), "{error}");
    }

    #[test]
    fn actions_are_sorted_and_clips_keep_their_rows() {
        let clips = [
            ("a", "wave", vec![0.0, 1.0, 2.0, 3.0]),
            ("b", "nod", vec![4.0, 5.0, 6.0, 7.0, 8.0, 9.0]),
            ("c", "wave", vec![0.0; 4]),
        ];
        let dataset = build(&clip_set(&TWO_SCALARS, &clips), &DatasetOptions::default()).unwrap();
        assert_eq!(dataset.description.actions, ["nod", "wave"]);
        let actions: Vec<usize> = dataset.description.clips.iter().map(|c| c.action).collect();
        assert_eq!(actions, [1, 0, 1]);
        assert_eq!(dataset.first_rows, [0, 2, 5]);
        let mut poses = dataset.clip_poses(1).to_vec();
        dataset.description.destandardize(&mut poses);
        assert_eq!(poses, [4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    }

    #[test]
    fn positions_share_a_scale_and_scalars_do_not() {
        let kinds =
            [GroupKind::Position, GroupKind::Position, GroupKind::Scalar, GroupKind::Scalar];
        let poses = vec![
            1.0, 2.0, 3.0, 40.0, 50.0, 60.0, 7.0, 8.0, //
            3.0, 2.0, 9.0, 10.0, 11.0, 12.0, 9.0, 80.0,
        ];
        let dataset =
            build(&clip_set(&kinds, &[("a", "x", poses)]), &DatasetOptions::default()).unwrap();
        let scale = &dataset.description.scale;
        assert_eq!([scale[0], scale[2], scale[3]], [scale[5]; 3]);
        assert_eq!(scale[6], 1.0);
        assert_eq!(scale[7], 36.0);
    }

    #[test]
    fn constant_channel_comes_back_exactly_whatever_the_decoder_says() {
        let poses = vec![0.3, 1.0, 0.3, 2.0, 0.3, 5.0];
        let dataset =
            build(&clip_set(&TWO_SCALARS, &[("a", "x", poses)]), &DatasetOptions::default())
                .unwrap();
        assert!(dataset.description.is_constant(0) && !dataset.description.is_constant(1));
        assert_eq!(dataset.poses[0], 0.0);
        let mut decoded = vec![5.0, 0.0];
        dataset.description.destandardize(&mut decoded);
        assert_eq!(decoded[0], 0.3);
    }

    #[test]
    fn without_standardization_the_poses_are_the_values() {
        let poses = vec![0.3, 1.0, 0.3, 2.0];
        let options = DatasetOptions { standardization: Standardization::None };
        let dataset =
            build(&clip_set(&TWO_SCALARS, &[("a", "x", poses.clone())]), &options).unwrap();
        assert_eq!(dataset.poses, poses);
    }

    proptest! {
        #[test]
        fn destandardize_undoes_standardize(
            poses in prop::collection::vec(-1000.0..1000.0f32, 11 * 5)
        ) {
            use GroupKind::{Rotation6d, Scalar, Translation};
            let kinds = [Translation, Rotation6d, Scalar, Scalar];
            let set = clip_set(&kinds, &[("a", "x", poses.clone())]);
            let dataset = build(&set, &DatasetOptions::default()).unwrap();
            let mean: f32 = dataset.poses.iter().step_by(11).sum();
            prop_assert!(mean.abs() < 1e-4);
            let mut again = dataset.poses.clone();
            dataset.description.destandardize(&mut again);
            for (again, original) in again.iter().zip(&poses) {
                prop_assert!((again - original).abs() < 1e-3);
            }
        }
    }
}
