//! Range, speed, constancy and jumps of one channel or one group of channels.

use std::ops::Range;

use super::{JUMP_FACTOR, Place, RowReport};
use crate::body::rotation::Rotation;
use crate::clip::ClipSet;
use crate::layout::{Group, GroupKind, PoseLayout};

/// More channels than this are reported by group: a screen has about as many lines.
const CHANNEL_ROWS_MAX: usize = 32;

/// Channels that are reported together.
pub(super) struct Row {
    name: String,
    unit: &'static str,
    is_rotation: bool,
    channels: Range<usize>,
}

/// A row's report and its jumps.
pub(super) struct Analysis {
    pub report: RowReport,
    pub jumps: Vec<Jump>,
}

/// A change between two frames far above the row's usual.
#[derive(Clone)]
pub(super) struct Jump {
    /// Change over threshold.
    pub severity: f32,
    pub place: Place,
}

/// One row per channel, or per group where channels are many; rotations are always one row.
pub(super) fn rows(layout: &PoseLayout) -> Vec<Row> {
    let names = layout.channel_names();
    let by_group = layout.channel_count() > CHANNEL_ROWS_MAX;
    layout
        .ranges()
        .flat_map(|(group, range)| match by_group || group.kind == GroupKind::Rotation6d {
            true => vec![Row::new(&group.name, group, range)],
            false => range
                .map(|channel| Row::new(&names[channel], group, channel..channel + 1))
                .collect(),
        })
        .collect()
}

impl Row {
    fn new(name: &str, group: &Group, channels: Range<usize>) -> Self {
        let is_rotation = group.kind == GroupKind::Rotation6d;
        Self {
            name: name.to_string(),
            unit: if is_rotation { "deg" } else { group.unit.suffix() },
            is_rotation,
            channels,
        }
    }

    /// Looks at every pose once.
    pub fn analyse(&self, clip_set: &ClipSet) -> Analysis {
        let (mut min, mut max) = (f32::INFINITY, f32::NEG_INFINITY);
        let mut non_finite_count = 0;
        let mut changes = Vec::new(); // (clip, frame after the change, size)
        for (clip_index, clip) in clip_set.clips.iter().enumerate() {
            let mut before: Option<&[f32]> = None;
            let poses = clip.poses.chunks_exact(clip_set.layout.channel_count().max(1));
            for (frame, pose) in poses.enumerate() {
                let values = &pose[self.channels.clone()];
                non_finite_count += values.iter().filter(|value| !value.is_finite()).count();
                if !values.iter().all(|value| value.is_finite()) {
                    before = None;
                    continue;
                }
                let (low, high) = self.extent(values);
                (min, max) = (min.min(low), max.max(high));
                if let Some(before) = before {
                    changes.push((clip_index, frame, self.change(before, values)));
                }
                before = Some(values);
            }
        }
        let threshold = JUMP_FACTOR * usual_change(&changes);
        let jumps: Vec<Jump> = changes
            .iter()
            .filter(|(.., change)| *change > threshold)
            .map(|&(clip, frame, change)| Jump {
                severity: change / threshold,
                place: Place {
                    clip: clip_set.clips[clip].name.clone(),
                    frame,
                    row: self.name.clone(),
                    value: format!("{change:.4} {}", self.unit),
                },
            })
            .collect();
        let change_max = changes.iter().map(|(.., change)| *change).fold(0.0, f32::max);
        Analysis {
            report: RowReport {
                name: self.name.clone(),
                unit: self.unit.to_string(),
                min,
                max,
                speed_max: change_max * clip_set.rate_hz as f32,
                non_finite_count,
                jump_count: jumps.len(),
            },
            jumps,
        }
    }

    fn extent(&self, values: &[f32]) -> (f32, f32) {
        if self.is_rotation {
            let angle_deg = angle_deg(&Rotation::IDENTITY, &rotation(values));
            return (angle_deg, angle_deg);
        }
        let min = values.iter().copied().fold(f32::INFINITY, f32::min);
        (min, values.iter().copied().fold(f32::NEG_INFINITY, f32::max))
    }

    /// Size of the step from one value to the next: distance, or angle in degrees.
    fn change(&self, from: &[f32], to: &[f32]) -> f32 {
        if self.is_rotation {
            return angle_deg(&rotation(from), &rotation(to));
        }
        from.iter().zip(to).map(|(from, to)| (to - from).powi(2)).sum::<f32>().sqrt()
    }
}

/// 99th percentile of the changes that are not 0: a servo that rests most of the time must not make
/// every move a jump.
fn usual_change(changes: &[(usize, usize, f32)]) -> f32 {
    let mut sizes: Vec<f32> =
        changes.iter().map(|(.., change)| *change).filter(|change| *change > 0.0).collect();
    if sizes.is_empty() {
        return f32::INFINITY;
    }
    let index = sizes.len() * 99 / 100;
    *sizes.select_nth_unstable_by(index, f32::total_cmp).1
}

fn rotation(channels: &[f32]) -> Rotation {
    Rotation::from_6d(&std::array::from_fn(|i| f64::from(channels[i])))
}

fn angle_deg(from: &Rotation, to: &Rotation) -> f32 {
    from.angle_to_rad(to).to_degrees() as f32
}

/// Names of channels that never change, and of rotations none of whose elements do.
pub(super) fn constant_channels(clip_set: &ClipSet) -> Vec<String> {
    let layout = &clip_set.layout;
    let width = layout.channel_count().max(1);
    let poses = || clip_set.clips.iter().flat_map(|clip| clip.poses.chunks_exact(width));
    let Some(first) = poses().next() else {
        return Vec::new();
    };
    let mut is_constant = vec![true; width];
    for pose in poses() {
        for ((constant, value), first) in is_constant.iter_mut().zip(pose).zip(first) {
            // Files of six digits repeat a constant to about a millionth.
            *constant &= (value - first).abs() <= 1e-6 * first.abs().max(1e-3);
        }
    }
    let names = layout.channel_names();
    layout
        .ranges()
        .flat_map(|(group, range)| match group.kind {
            GroupKind::Rotation6d => match is_constant[range].iter().all(|&constant| constant) {
                true => vec![group.name.clone()],
                false => Vec::new(),
            },
            _ => range.filter(|&i| is_constant[i]).map(|i| names[i].clone()).collect(),
        })
        .collect()
}

/// The first `count_max` values that are not finite, in the order of clips and frames.
pub(super) fn first_non_finite(clip_set: &ClipSet, count_max: usize) -> Vec<Place> {
    let names = clip_set.layout.channel_names();
    let values = clip_set.clips.iter().flat_map(|clip| {
        let values = clip.poses.iter().enumerate();
        values.map(move |(index, value)| (&clip.name, index, value))
    });
    values
        .filter(|(.., value)| !value.is_finite())
        .take(count_max)
        .map(|(clip, index, value)| Place {
            clip: clip.clone(),
            frame: index / names.len(),
            row: names[index % names.len()].clone(),
            value: value.to_string(),
        })
        .collect()
}
