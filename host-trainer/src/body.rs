//! Pose channels → joint positions, whatever the representation.
//!
//! In:  a [`PoseLayout`], poses, and for rotations a [`Skeleton`].
//! Out: one point a joint to `represent`, pictures and metrics.

pub mod rotation;
pub mod skeleton;
pub mod infer_skeleton;
pub mod kinematics;

use crate::body::rotation::{Rotation, Vector, add};
use crate::body::skeleton::Skeleton;
use crate::layout::{GroupKind, PoseLayout};

/// Reads joint positions out of poses of one layout.
#[derive(Clone, Debug)]
pub struct Body {
    channels: BodyChannels,
    joint_count: usize,
}

/// Where the joints stand among the channels.
#[derive(Clone, Debug)]
enum BodyChannels {
    /// Absolute positions, joint after joint.
    Absolute,
    /// Root translation, then the other joints relative to it.
    Relative,
    /// Rotations over a tree; first channel of the root, and of every joint that has a rotation. //
    /// (joint)
    Rotations { skeleton: Skeleton, root: usize, rotations: Vec<Option<usize>> },
}

impl Body {
    /// `None` where the layout is not a body: servos, a lone head, or rotations without their
    /// skeleton.
    pub fn new(layout: &PoseLayout, skeleton: Option<&Skeleton>) -> Option<Self> {
        let kinds: Vec<GroupKind> = layout.groups.iter().map(|group| group.kind).collect();
        let all_positions =
            |kinds: &[GroupKind]| kinds.iter().all(|kind| *kind == GroupKind::Position);
        let (first, others) = kinds.split_first()?;
        let channels = match first {
            GroupKind::Position if all_positions(others) => BodyChannels::Absolute,
            GroupKind::Translation if !others.is_empty() && all_positions(others) => {
                BodyChannels::Relative
            }
            _ => rotation_channels(layout, skeleton?)?,
        };
        let joint_count = match &channels {
            BodyChannels::Rotations { skeleton, .. } => skeleton.joint_count(),
            _ => kinds.len(),
        };
        Some(Self { channels, joint_count })
    }

    /// Whether the joints are given by rotations rather than positions.
    pub fn has_rotations(&self) -> bool {
        matches!(self.channels, BodyChannels::Rotations { .. })
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.joint_count
    }

    /// Joint positions of one pose, in the unit of the layout's root. // (channel) → (joint)
    pub fn joint_positions(&self, pose: &[f32]) -> Vec<Vector> {
        match &self.channels {
            BodyChannels::Absolute => pose.chunks_exact(3).map(vector).collect(),
            BodyChannels::Relative => {
                let root = vector(pose);
                let others = pose.chunks_exact(3).skip(1).map(|xyz| add(root, vector(xyz)));
                std::iter::once(root).chain(others).collect()
            }
            BodyChannels::Rotations { skeleton, root, rotations } => {
                let offsets: Vec<Vector> =
                    skeleton.offsets.iter().map(|offset| vector(offset)).collect();
                let locals = locals(rotations, pose);
                kinematics::forward(skeleton, &offsets, vector(&pose[*root..]), &locals)
            }
        }
    }

    /// Joint positions of one pose on other bones than the skeleton's; rotations only. // offsets:
    /// (joint)
    ///
    /// `None` for a body that is given by positions: it has no bones to exchange.
    pub fn joint_positions_on(&self, offsets: &[Vector], pose: &[f32]) -> Option<Vec<Vector>> {
        let BodyChannels::Rotations { skeleton, .. } = &self.channels else {
            return None;
        };
        let (root, locals) = self.root_and_rotations(pose)?;
        Some(kinematics::forward(skeleton, offsets, root, &locals))
    }

    /// Root position and local rotations of one pose; `None` for a body that is given by positions.
    /// // (joint)
    pub fn root_and_rotations(&self, pose: &[f32]) -> Option<(Vector, Vec<Rotation>)> {
        let BodyChannels::Rotations { root, rotations, .. } = &self.channels else {
            return None;
        };
        Some((vector(&pose[*root..]), locals(rotations, pose)))
    }
}

/// Rotation groups belong to the joints of their names; where the names differ, to the joints in
/// order.
fn rotation_channels(layout: &PoseLayout, skeleton: &Skeleton) -> Option<BodyChannels> {
    let of_kind = |kind| layout.ranges().filter(move |(group, _)| group.kind == kind);
    let (_, root) = of_kind(GroupKind::Translation).next()?;
    let starts: Vec<(&str, usize)> = of_kind(GroupKind::Rotation6d)
        .map(|(group, range)| (group.name.as_str(), range.start))
        .collect();
    let by_name: Vec<Option<usize>> = skeleton
        .names
        .iter()
        .map(|joint| starts.iter().find(|(name, _)| name == joint).map(|(_, start)| *start))
        .collect();
    let rotations = if by_name.iter().flatten().count() == starts.len() && !starts.is_empty() {
        by_name
    } else if starts.len() == skeleton.joint_count() {
        starts.iter().map(|(_, start)| Some(*start)).collect()
    } else {
        return None;
    };
    Some(BodyChannels::Rotations { skeleton: skeleton.clone(), root: root.start, rotations })
}

fn locals(rotations: &[Option<usize>], pose: &[f32]) -> Vec<Rotation> {
    let read = |start: usize| std::array::from_fn(|element| f64::from(pose[start + element]));
    rotations
        .iter()
        .map(|start| start.map_or(Rotation::IDENTITY, |start| Rotation::from_6d(&read(start))))
        .collect()
}

/// First three channels as a vector.
fn vector(channels: &[f32]) -> Vector {
    std::array::from_fn(|axis| f64::from(channels[axis]))
}

/// Joint positions of one pose; see [`Body`], which is faster for many poses. // (channel) →
/// (joint)
pub fn to_joint_positions(
    layout: &PoseLayout,
    pose: &[f32],
    skeleton: Option<&Skeleton>,
) -> Option<Vec<Vector>> {
    Some(Body::new(layout, skeleton)?.joint_positions(pose))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Group, Unit};

    fn layout(groups: &[(&str, GroupKind)]) -> PoseLayout {
        let groups = groups
            .iter()
            .map(|(name, kind)| Group { name: (*name).to_owned(), kind: *kind, unit: Unit::Metre })
            .collect();
        PoseLayout { groups }
    }

    fn arm() -> Skeleton {
        Skeleton {
            names: ["hip", "hand", "tip"].map(str::to_owned).to_vec(),
            parents: vec![None, Some(0), Some(1)],
            offsets: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
        }
    }

    #[test]
    fn servos_heads_and_rotations_without_a_skeleton_are_no_body() {
        use GroupKind::{Rotation6d, Scalar, Translation};
        let head = [("head", Translation), ("turn", Rotation6d), ("ear", Scalar)];
        for (groups, skeleton) in [
            (&[][..], None),
            (&[("jaw", Scalar)][..], None),
            (&head[..], None),
            (&head[..2], Some(arm())),
        ] {
            assert!(Body::new(&layout(groups), skeleton.as_ref()).is_none(), "{groups:?}");
        }
    }

    #[test]
    fn rotations_belong_to_the_joints_of_their_names() {
        use GroupKind::{Rotation6d, Translation};
        let groups = [("root", Translation), ("hand", Rotation6d), ("hip", Rotation6d)];
        let body = Body::new(&layout(&groups), Some(&arm())).unwrap();
        let identity = Rotation::IDENTITY.to_6d();
        let quarter = Rotation::from_rotation_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let mut pose = vec![5.0, 0.0, 0.0];
        pose.extend(quarter.to_6d().map(|x| x as f32));
        pose.extend(identity.map(|x| x as f32));
        let positions = body.joint_positions(&pose);
        // The hand's quarter turn carries the tip from +y to -x; the hip stays.
        let expected = [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [4.0, 0.0, 0.0]];
        for (found, expected) in positions.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-6);
        }
    }
}
