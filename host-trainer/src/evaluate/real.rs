//! Recorded motions as a classifier and a ruler see them: of bodies joint positions in metres, else the channels.
//!
//! In:  the clips as they were imported, before any representation.
//! Out: [`RealMotions`], what generated motions are measured against.
//!
//! Why here: real clips are measured on their own positions. Taken through a representation, its error would be theirs
//! too, and the distance to them would come out too small.

use rayon::prelude::*;

use crate::body::Body;
use crate::body::skeleton::Skeleton;
use crate::classifier::example::Input;
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{GroupKind, PoseLayout, Unit};

/// Clips of both sides of the split.
#[derive(Clone, Debug, PartialEq)]
pub struct RealMotions {
    /// What a pose is.
    pub input: Input,
    /// Names of the actions, sorted.
    pub actions: Vec<String>,
    /// Names of the joints, the root first, or of the channels; joints are named by their groups where the clips name
    /// no skeleton.
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
    /// Of a body the joints' x, y and z in metres, else the channels; at least one pose. // (frame, channel)
    pub positions: Vec<f32>,
    /// Number of poses.
    pub frame_count: usize,
}

impl RealMotions {
    /// Reads what a classifier sees out of clips; `held_out` has the layout of `training`.
    ///
    /// # Errors
    /// A clip without poses; a held-out clip of an action that no training clip shows.
    pub fn new(training: &ClipSet, held_out: Option<&ClipSet>) -> Result<Self> {
        let layout = &training.layout;
        let reader = PoseReader::new(layout, training.skeleton.as_ref());
        let mut actions: Vec<String> =
            training.clips.iter().map(|clip| clip.action.clone()).collect();
        actions.sort();
        actions.dedup();
        let read = |clip: &Clip| read_clip(clip, layout, &reader, &actions);
        let read_all = |clips: &[Clip]| clips.par_iter().map(read).collect::<Result<Vec<_>>>();
        let joints = match (reader.input(), &training.skeleton) {
            (Input::Channels, _) => layout.channel_names(),
            (Input::Joints, Some(skeleton)) => skeleton.names.clone(),
            (Input::Joints, None) => layout.groups.iter().map(|group| group.name.clone()).collect(),
        };
        Ok(Self {
            input: reader.input(),
            joints,
            rate_hz: training.rate_hz,
            held_out: read_all(held_out.map_or(&[], |clip_set| &clip_set.clips))?,
            training: read_all(&training.clips)?,
            actions,
        })
    }

    /// Numbers of a pose.
    pub fn channel_count(&self) -> usize {
        match self.input {
            Input::Joints => self.joints.len() * 3,
            Input::Channels => self.joints.len(),
        }
    }
}

fn read_clip(
    clip: &Clip,
    layout: &PoseLayout,
    reader: &PoseReader,
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
    let mut positions = Vec::with_capacity(frame_count * reader.channel_count());
    for pose in clip.poses.chunks_exact(layout.channel_count()) {
        reader.read(pose, &mut positions);
    }
    Ok(RealMotion { name: clip.name.clone(), action, positions, frame_count })
}

/// Reads what a classifier sees out of poses of one layout.
pub(crate) struct PoseReader {
    /// `None`: the channels as they are.
    body: Option<Body>,
    metres: f64,
    layout_channel_count: usize,
}

impl PoseReader {
    pub fn new(layout: &PoseLayout, skeleton: Option<&Skeleton>) -> Self {
        Self {
            body: Body::new(layout, skeleton),
            metres: metres_of(layout),
            layout_channel_count: layout.channel_count(),
        }
    }

    pub fn input(&self) -> Input {
        if self.body.is_some() { Input::Joints } else { Input::Channels }
    }

    /// Numbers of what is read of one pose.
    pub fn channel_count(&self) -> usize {
        self.body.as_ref().map_or(self.layout_channel_count, |body| 3 * body.joint_count())
    }

    /// Appends what a classifier sees of one pose.
    pub fn read(&self, pose: &[f32], seen: &mut Vec<f32>) {
        match &self.body {
            Some(body) => seen.extend(positions_of(body, pose, self.metres)),
            None => seen.extend_from_slice(pose),
        }
    }
}

/// Joints of one pose, x, y and z each, in metres.
fn positions_of(body: &Body, pose: &[f32], metres: f64) -> impl Iterator<Item = f32> {
    let joints = body.joint_positions(pose).into_iter().flatten();
    joints.map(move |value| (value * metres) as f32)
}

/// Metres per 1 of a body's lengths; lengths without a unit are taken as they are.
fn metres_of(layout: &PoseLayout) -> f64 {
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
    fn servos_are_seen_as_their_channels() {
        let clips = character::clip_set(1, 1);
        let real = RealMotions::new(&clips, None).unwrap();
        assert_eq!((real.input, real.channel_count()), (Input::Channels, character::JOINT_COUNT));
        assert_eq!(real.training[0].positions, clips.clips[0].poses);
        assert!(real.joints[0].ends_with("_deg"));
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
