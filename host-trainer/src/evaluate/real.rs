//! Recorded motions as a classifier and a ruler see them: joint positions in metres.
//!
//! In:  the clips as they were imported, before any representation.
//! Out: [`RealMotions`], what generated motions are measured against.
//!
//! Why here: real clips are measured on their own positions. Taken through a representation, its error would be theirs
//! too, and the distance to them would come out too small.

use std::path::Path;

use rayon::prelude::*;

use crate::body::Body;
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout, Unit};

/// Clips of both sides of the split.
#[derive(Clone, Debug, PartialEq)]
pub struct RealMotions {
    /// Names of the actions, sorted.
    pub actions: Vec<String>,
    /// Names of the joints, the root first; their own groups' where the clips name no skeleton.
    pub joints: Vec<String>,
    /// Poses per second.
    pub rate_hz: f64,
    /// What generated motions are compared with.
    pub training: Vec<RealMotion>,
    /// What training did not see; empty without a split.
    pub held_out: Vec<RealMotion>,
}

/// One clip.
#[derive(Clone, Debug, PartialEq)]
pub struct RealMotion {
    /// Its name.
    pub name: String,
    /// Index into the actions.
    pub action: usize,
    /// Joints' x, y and z in metres, at least one pose. // (frame, joint · 3)
    pub positions: Vec<f32>,
    /// Number of poses.
    pub frame_count: usize,
}

impl RealMotions {
    /// Reads joint positions out of clips; `held_out` has the layout of `training`.
    ///
    /// # Errors
    /// Clips that are not a body, or have no pose; a held-out clip of an action that no training clip shows.
    pub fn new(training: &ClipSet, held_out: Option<&ClipSet>) -> Result<Self> {
        let source = training.clips.first().map_or(Path::new("clips"), |clip| &clip.source);
        let layout = &training.layout;
        let body = Body::new(layout, training.skeleton.as_ref()).ok_or_else(|| {
            let kinds: Vec<&str> = layout.groups.iter().map(|group| group.kind.name()).collect();
            let expected = "joint positions, or rotations of a skeleton's joints";
            let remedy = "only bodies can be evaluated: the classifier sees joints";
            Error::bad_input(source, "channel groups", kinds.join(" "), expected, remedy)
        })?;
        let mut actions: Vec<String> =
            training.clips.iter().map(|clip| clip.action.clone()).collect();
        actions.sort();
        actions.dedup();
        let read = |clip: &Clip| read_clip(clip, layout, &body, &actions);
        let read_all = |clips: &[Clip]| clips.par_iter().map(read).collect::<Result<Vec<_>>>();
        let joints = match &training.skeleton {
            Some(skeleton) => skeleton.names.clone(),
            None => layout.groups.iter().map(|group| group.name.clone()).collect(),
        };
        Ok(Self {
            joints,
            rate_hz: training.rate_hz,
            held_out: read_all(held_out.map_or(&[], |clip_set| &clip_set.clips))?,
            training: read_all(&training.clips)?,
            actions,
        })
    }

    /// Numbers of a pose.
    pub fn channel_count(&self) -> usize {
        self.joints.len() * 3
    }
}

fn read_clip(
    clip: &Clip,
    layout: &PoseLayout,
    body: &Body,
    actions: &[String],
) -> Result<RealMotion> {
    let refused = |field: &str, value: &str, expected: &str| {
        Error::bad_input(&clip.source, field, value, expected, "remove the clip or correct it")
    };
    let action = actions
        .binary_search(&clip.action)
        .map_err(|_| refused("action", &clip.action, &format!("one of {}", actions.join(", "))))?;
    let frame_count = clip.frame_count(layout);
    if frame_count == 0 {
        return Err(refused("frames", "0", "at least 1"));
    }
    let metres = metres_of(layout);
    let poses = clip.poses.chunks_exact(layout.channel_count());
    let positions = poses.flat_map(|pose| positions_of(body, pose, metres)).collect();
    Ok(RealMotion { name: clip.name.clone(), action, positions, frame_count })
}

/// Joints of one pose, x, y and z each, in metres.
pub(crate) fn positions_of(body: &Body, pose: &[f32], metres: f64) -> impl Iterator<Item = f32> {
    let joints = body.joint_positions(pose).into_iter().flatten();
    joints.map(move |value| (value * metres) as f32)
}

/// Metres per 1 of a body's lengths; lengths without a unit are taken as they are.
pub(crate) fn metres_of(layout: &PoseLayout) -> f64 {
    let is_length = |kind| matches!(kind, GroupKind::Translation | GroupKind::Position);
    match layout.groups.iter().find(|group| is_length(group.kind)).map(|group| group.unit) {
        Some(Unit::Centimetre) => 0.01,
        Some(Unit::Millimetre) => 0.001,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::character;
    use crate::evaluate::specimen::clip_set;

    #[test]
    fn servos_are_refused() {
        let message = RealMotions::new(&character::clip_set(1, 1), None).unwrap_err().to_string();
        assert!(message.contains("only bodies can be evaluated"), "{message}");
    }

    #[test]
    fn held_out_action_without_a_training_clip_is_refused() {
        let training = clip_set(&[("nod", 3)], 20);
        let message = RealMotions::new(&training, Some(&clip_set(&[("bow", 1)], 20))).unwrap_err();
        assert!(message.to_string().contains("action is bow, expected one of nod"), "{message}");
    }

    #[test]
    fn centimetres_become_metres() {
        let mut clips = clip_set(&[("nod", 1)], 4);
        let metres = RealMotions::new(&clips, None).unwrap();
        for group in &mut clips.layout.groups {
            group.unit = Unit::Centimetre;
        }
        clips.clips[0].poses.iter_mut().for_each(|value| *value *= 100.0);
        let centimetres = RealMotions::new(&clips, None).unwrap();
        let pairs = metres.training[0].positions.iter().zip(&centimetres.training[0].positions);
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
