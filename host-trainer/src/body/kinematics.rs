//! Joint rotations ↔ joint positions, over a [`Skeleton`]'s tree.
//!
//! In:  positions (from clips), rotations (from the decoder).
//! Out: local rotations to `represent`; joint positions to pictures and metrics.
//!
//! Convention: `position(child) = position(joint) + R(joint) · offset(child)` with
//! `R(joint) = R(parent) · local(joint)`, as in SMPL and BVH. One rotation then serves all children
//! of a joint, which is exact only if they are rigid among themselves. They are, in all 1191 clips
//! of HumanAct12 (bones and the distances among the children of pelvis and spine3 vary by less than
//! 3 µm, the rounding of f32), so the convention that restarts a chain at every joint, as
//! Action2Motion's, is not needed.
//!
//! Twist: the position of one child does not fix the rotation about its own bone. We take none
//! relative to the parent: the rotation is then a function of the pose alone and as continuous as
//! the pose. Leaves have no child and stay at the identity. (Turning first to the mean direction of
//! a bone, to keep its half turn far from the data, was tried: of 2 million steps of HumanAct12
//! those above one radian fell from 2794 to 2764, so what jumps is the data.)

use faer::{Mat, Side};

use crate::body::rotation::{
    Rotation, Vector, add, any_perpendicular, length, scale, subtract, unit,
};
use crate::body::skeleton::Skeleton;

/// Gap between the two largest eigenvalues, relative to their size, under which several child
/// directions are one.
const DIRECTION_GAP_MIN: f64 = 1e-6;

/// Joint positions from local rotations. // (joint)
///
/// # Shapes
/// `offsets` (joint), own bones of the body · `root` position of joint 0 · `locals` (joint)
pub fn forward(
    skeleton: &Skeleton,
    offsets: &[Vector],
    root: Vector,
    locals: &[Rotation],
) -> Vec<Vector> {
    let mut globals: Vec<Rotation> = Vec::with_capacity(locals.len());
    let mut positions: Vec<Vector> = Vec::with_capacity(locals.len());
    for (joint, parent) in skeleton.parents.iter().enumerate() {
        match parent {
            None => {
                globals.push(locals[joint]);
                positions.push(root);
            }
            Some(parent) => {
                globals.push(globals[*parent].after(&locals[joint]));
                let bone = globals[*parent].apply(offsets[joint]);
                positions.push(add(positions[*parent], bone));
            }
        }
    }
    positions
}

/// Finds local rotations of pose after pose; remembers the last one where a pose leaves a choice.
#[derive(Clone, Debug)]
pub struct InverseKinematics<'a> {
    skeleton: &'a Skeleton,
    children: Vec<Vec<usize>>,
    offsets: &'a [Vector],
    previous: Vec<Rotation>,
}

impl<'a> InverseKinematics<'a> {
    /// Starts a clip of a body with these bones. // offsets: (joint)
    pub fn new(skeleton: &'a Skeleton, offsets: &'a [Vector]) -> Self {
        Self {
            skeleton,
            children: skeleton.children(),
            offsets,
            previous: vec![Rotation::IDENTITY; skeleton.joint_count()],
        }
    }

    /// Local rotations of the next pose. // positions: (joint) → (joint)
    pub fn solve(&mut self, positions: &[Vector]) -> Vec<Rotation> {
        let mut globals: Vec<Rotation> = Vec::with_capacity(positions.len());
        for joint in 0..positions.len() {
            let parent = match self.skeleton.parents[joint] {
                None => Rotation::IDENTITY,
                Some(parent) => globals[parent],
            };
            let local = self.solve_joint(joint, &parent.inverse(), positions);
            globals.push(parent.after(&local));
            self.previous[joint] = local;
        }
        self.previous.clone()
    }

    fn solve_joint(&self, joint: usize, to_parent: &Rotation, positions: &[Vector]) -> Rotation {
        let bones: Vec<(Vector, Vector)> = self.children[joint]
            .iter()
            .map(|child| {
                let bone = subtract(positions[*child], positions[joint]);
                (self.offsets[*child], to_parent.apply(bone))
            })
            .filter(|(rest, bone)| unit(*rest).is_some() && unit(*bone).is_some())
            .collect();
        if let Some(rotation) = align(&bones) {
            return rotation;
        }
        let longest = bones.iter().max_by(|a, b| length(a.0).total_cmp(&length(b.0)));
        longest
            .map_or(Rotation::IDENTITY, |(rest, bone)| swing(*rest, *bone, &self.previous[joint]))
    }
}

/// The swing from `rest` to `bone`; at the half turn, where that is undetermined, the way on from
/// the previous pose.
fn swing(rest: Vector, bone: Vector, previous: &Rotation) -> Rotation {
    Rotation::between(rest, bone).unwrap_or_else(|| {
        let way = Rotation::between(previous.apply(rest), bone);
        way.map_or_else(|| half_turn(rest), |way| way.after(previous))
    })
}

fn half_turn(direction: Vector) -> Rotation {
    let axis = any_perpendicular(unit(direction).unwrap_or([1.0, 0.0, 0.0]));
    Rotation::from_rotation_vector(scale(axis, std::f64::consts::PI))
}

/// The rotation that takes the first vectors of all pairs closest to the second, in least squares.
///
/// `None` unless the pairs span a plane.
///
/// Source: Horn, 1987: the quaternion is the eigenvector of the largest eigenvalue of a symmetric 4
/// × 4 matrix.
pub fn align(pairs: &[(Vector, Vector)]) -> Option<Rotation> {
    if pairs.len() < 2 {
        return None;
    }
    let moment = |row: usize, column: usize| -> f64 {
        pairs.iter().map(|(from, to)| from[row] * to[column]).sum()
    };
    let [xx, xy, xz] = std::array::from_fn(|column| moment(0, column));
    let [yx, yy, yz] = std::array::from_fn(|column| moment(1, column));
    let [zx, zy, zz] = std::array::from_fn(|column| moment(2, column));
    let symmetric: [[f64; 4]; 4] = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    let size: f64 = pairs.iter().map(|(from, to)| length(*from) * length(*to)).sum();
    let eigen = Mat::from_fn(4, 4, |row, column| symmetric[row][column])
        .self_adjoint_eigen(Side::Lower)
        .ok()?;
    let (values, vectors) = (eigen.S(), eigen.U());
    let gap = values[3] - values[2]; // Ascending order.
    (gap > DIRECTION_GAP_MIN * size)
        .then(|| Rotation::from_quaternion(std::array::from_fn(|row| vectors[(row, 3)])))
}

/// Rest offsets of one body, measured on its own poses. // positions: (frame, joint) → (joint)
///
/// Lengths are means over the frames. Directions are `rest`'s, except that several children of one
/// joint keep the shape among themselves that they have in the poses, turned as a whole as close to
/// `rest` as it goes: so bodies of different build get the same rest pose, and inverse kinematics
/// stays exact.
pub fn measure_offsets(
    skeleton: &Skeleton,
    rest: &[Vector],
    frames: &[Vec<Vector>],
) -> Vec<Vector> {
    let mut offsets = vec![[0.0; 3]; skeleton.joint_count()];
    for (joint, children) in skeleton.children().iter().enumerate() {
        for child in children {
            let total: f64 = frames.iter().map(|p| length(subtract(p[*child], p[joint]))).sum();
            let direction = unit(rest[*child]).unwrap_or([0.0, 1.0, 0.0]);
            offsets[*child] = scale(direction, total / frames.len().max(1) as f64);
        }
        if children.len() > 1 {
            let shape = mean_shape(joint, children, &offsets, frames);
            for (child, offset) in children.iter().zip(shape) {
                offsets[*child] = offset;
            }
        }
    }
    offsets
}

/// Mean offsets of several children in the frame of their joint. // (child)
fn mean_shape(
    joint: usize,
    children: &[usize],
    guess: &[Vector],
    frames: &[Vec<Vector>],
) -> Vec<Vector> {
    let mut sums = vec![[0.0; 3]; children.len()];
    let mut count = 0.0;
    for positions in frames {
        let pairs: Vec<(Vector, Vector)> = children
            .iter()
            .map(|child| (guess[*child], subtract(positions[*child], positions[joint])))
            .collect();
        if let Some(rotation) = align(&pairs) {
            let back = rotation.inverse();
            for (sum, (_, bone)) in sums.iter_mut().zip(&pairs) {
                *sum = add(*sum, back.apply(*bone));
            }
            count += 1.0;
        }
    }
    if count == 0.0 {
        return children.iter().map(|child| guess[*child]).collect();
    }
    sums.into_iter().map(|sum| scale(sum, 1.0 / count)).collect()
}

/// Distance of every joint between two poses.
pub fn joint_distances(a: &[Vector], b: &[Vector]) -> impl Iterator<Item = f64> {
    a.iter().zip(b).map(|(a, b)| length(subtract(*a, *b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_rotation() -> impl Strategy<Value = Rotation> {
        prop::array::uniform3(-1.5..1.5f64).prop_map(Rotation::from_rotation_vector)
    }

    fn rest(skeleton: &Skeleton) -> Vec<Vector> {
        skeleton.offsets.iter().map(|offset| offset.map(f64::from)).collect()
    }

    fn largest_distance(a: &[Vector], b: &[Vector]) -> f64 {
        joint_distances(a, b).fold(0.0, f64::max)
    }

    #[test]
    fn one_direction_does_not_fix_a_rotation() {
        let x = [1.0, 0.0, 0.0];
        assert_eq!(align(&[(x, x)]), None);
        assert_eq!(align(&[(x, x), (scale(x, 2.0), scale(x, 2.0))]), None);
    }

    #[test]
    fn collapsed_pose_gives_rotations_all_the_same() {
        let skeleton = Skeleton::smpl24();
        let offsets = rest(&skeleton);
        let locals = InverseKinematics::new(&skeleton, &offsets).solve(&vec![[1.0; 3]; 24]);
        assert_eq!(locals, vec![Rotation::IDENTITY; 24]);
    }

    #[test]
    fn bone_that_passes_through_the_half_turn_moves_on_smoothly() {
        let skeleton = Skeleton {
            names: vec!["a".into(), "b".into()],
            parents: vec![None, Some(0)],
            offsets: vec![[0.0; 3], [1.0, 0.0, 0.0]],
        };
        let offsets = rest(&skeleton);
        let mut inverse = InverseKinematics::new(&skeleton, &offsets);
        let bone_at = |angle_deg: i32| {
            let (sine, cosine) = f64::from(angle_deg).to_radians().sin_cos();
            [cosine, sine, 0.0]
        };
        let before = inverse.solve(&[[0.0; 3], bone_at(179)])[0];
        let at = inverse.solve(&[[0.0; 3], bone_at(180)])[0];
        assert!(before.angle_to_rad(&at) < 0.02);
    }

    proptest! {
        #[test]
        fn align_finds_the_rotation_of_rigid_points(
            rotation in any_rotation(),
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 3),
        ) {
            let normal = crate::body::rotation::cross(
                subtract(points[1], points[0]), subtract(points[2], points[0]));
            prop_assume!(length(normal) > 0.1);
            let pairs: Vec<_> =
                points.iter().map(|point| (*point, rotation.apply(*point))).collect();
            let found = align(&pairs).unwrap();
            prop_assert!(found.angle_to_rad(&rotation) < 1e-6);
        }

        #[test]
        fn forward_undoes_inverse_for_any_rigid_motion(
            locals in prop::collection::vec(any_rotation(), 24),
            root in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let skeleton = Skeleton::smpl24();
            let offsets = rest(&skeleton);
            let positions = forward(&skeleton, &offsets, root, &locals);
            let found = InverseKinematics::new(&skeleton, &offsets).solve(&positions);
            let again = forward(&skeleton, &offsets, root, &found);
            prop_assert!(largest_distance(&positions, &again) < 1e-9);
        }

        #[test]
        fn bones_are_measured_exactly_whatever_the_rest_pose_says(
            locals in prop::collection::vec(any_rotation(), 24),
            stretch in prop::collection::vec(0.7..1.3f64, 24),
        ) {
            let skeleton = Skeleton::smpl24();
            let own: Vec<Vector> = rest(&skeleton)
                .iter()
                .zip(&stretch)
                .map(|(offset, factor)| scale(*offset, *factor))
                .collect();
            let positions = forward(&skeleton, &own, [0.0; 3], &locals);
            let frames = [positions.clone()];
            let measured = measure_offsets(&skeleton, &rest(&skeleton), &frames);
            let found = InverseKinematics::new(&skeleton, &measured).solve(&positions);
            let again = forward(&skeleton, &measured, [0.0; 3], &found);
            prop_assert!(largest_distance(&positions, &again) < 1e-9);
        }
    }
}
