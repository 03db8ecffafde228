//! Generated poses → BVH, for animation programs.
//!
//! In:  a [`Motion`] of joint rotations with its skeleton.
//! Out: text: the hierarchy, then root position and Euler angles a frame.
//!
//! Euler order is z, x, y, the commonest one: `R = Rz · Rx · Ry`, angles in degrees. Lengths stay
//! in the unit of the model; the root's rest offset is zero because its position is a channel.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

use crate::body::Body;
use crate::body::rotation::{Rotation, Vector};
use crate::body::skeleton::Skeleton;
use crate::export::Motion;

/// Sine of the x angle above which z and y turn about one axis and only their sum is known.
const GIMBAL_LOCK_SINE: f64 = 1.0 - 1e-12;

/// Writes the whole file, or `None` where the motion is not a body of rotations.
pub fn emit(motion: &Motion) -> Option<String> {
    let skeleton = motion.skeleton.as_ref()?;
    let body = Body::new(&motion.layout, Some(skeleton))?;
    let frames: Vec<(Vector, Vec<Rotation>)> =
        motion.frames().map(|pose| body.root_and_rotations(pose)).collect::<Option<_>>()?;
    let children = skeleton.children();
    let order = depth_first(&children);
    let mut text = String::from("HIERARCHY\n");
    emit_joint(&mut text, skeleton, &children, 0, 0);
    // Writing to a String cannot fail.
    let _ =
        write!(text, "MOTION\nFrames: {}\nFrame Time: {:.8}\n", frames.len(), 1.0 / motion.rate_hz);
    for (root, locals) in frames {
        let angles = order.iter().flat_map(|joint| euler_zxy_deg(&locals[*joint]));
        let cells: Vec<String> =
            root.into_iter().chain(angles).map(|value| format!("{value:.6}")).collect();
        text.push_str(&cells.join(" "));
        text.push('\n');
    }
    Some(text)
}

/// Joints in the order in which the hierarchy names them.
fn depth_first(children: &[Vec<usize>]) -> Vec<usize> {
    let mut order = Vec::with_capacity(children.len());
    let mut open = vec![0];
    while let Some(joint) = open.pop() {
        order.push(joint);
        open.extend(children[joint].iter().rev());
    }
    order
}

/// A joint and, inside its braces, its children; recursion is as deep as the tree.
fn emit_joint(
    text: &mut String,
    skeleton: &Skeleton,
    children: &[Vec<usize>],
    joint: usize,
    depth: usize,
) {
    let indent = "\t".repeat(depth);
    let name = skeleton.names[joint].replace(char::is_whitespace, "_");
    let (word, [x, y, z], channels) = if joint == 0 {
        ("ROOT", [0.0; 3], "6 Xposition Yposition Zposition")
    } else {
        ("JOINT", skeleton.offsets[joint], "3")
    };
    let _ = write!(
        text,
        "{indent}{word} {name}\n{indent}{{\n{indent}\tOFFSET {x:.6} {y:.6} {z:.6}\n\
         {indent}\tCHANNELS {channels} Zrotation Xrotation Yrotation\n"
    );
    for child in &children[joint] {
        emit_joint(text, skeleton, children, *child, depth + 1);
    }
    if children[joint].is_empty() {
        let _ = writeln!(text, "{indent}\tEnd Site\n{indent}\t{{");
        let _ = writeln!(text, "{indent}\t\tOFFSET 0.000000 0.000000 0.000000\n{indent}\t}}");
    }
    let _ = writeln!(text, "{indent}}}");
}

/// Angles about z, x and y, in degrees, of `R = Rz · Rx · Ry`.
pub(crate) fn euler_zxy_deg(rotation: &Rotation) -> [f64; 3] {
    let [[r00, r01, _], [r10, r11, _], [r20, r21, r22]] = rotation.rows;
    let (z, x, y) = if r21.abs() < GIMBAL_LOCK_SINE {
        ((-r01).atan2(r11), r21.asin(), (-r20).atan2(r22))
    } else {
        (r10.atan2(r00), FRAC_PI_2.copysign(r21), 0.0)
    };
    [z, x, y].map(f64::to_degrees)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};
    use proptest::prelude::*;

    fn from_euler_zxy_deg([z, x, y]: [f64; 3]) -> Rotation {
        let about = |axis: usize, angle_deg: f64| {
            let mut vector = [0.0; 3];
            vector[axis] = angle_deg.to_radians();
            Rotation::from_rotation_vector(vector)
        };
        about(2, z).after(&about(0, x)).after(&about(1, y))
    }

    fn motion(kind: GroupKind) -> Motion {
        let skeleton = Skeleton::smpl24();
        let root = Group { name: "root".into(), kind: GroupKind::Translation, unit: Unit::Metre };
        let joints =
            skeleton.names.iter().map(|name| Group { name: name.clone(), kind, unit: Unit::One });
        let layout = PoseLayout { groups: std::iter::once(root).chain(joints).collect() };
        Motion {
            poses: vec![0.25; layout.channel_count() * 2],
            layout,
            skeleton: Some(skeleton),
            rate_hz: 20.0,
            action: "walk".into(),
            seconds: 0.1,
            seed: 7,
            provenance: "test".into(),
        }
    }

    #[test]
    fn body_of_positions_has_no_bvh() {
        assert_eq!(emit(&motion(GroupKind::Position)), None);
    }

    #[test]
    fn every_joint_has_its_channels() {
        let text = emit(&motion(GroupKind::Rotation6d)).unwrap();
        assert_eq!(text.matches("CHANNELS").count(), 24);
        assert_eq!(text.matches("End Site").count(), 5);
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        let rows: Vec<&str> =
            text.lines().skip_while(|line| !line.starts_with("Frame T")).collect();
        assert_eq!(rows[0], "Frame Time: 0.05000000");
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[1].split(' ').count(), 3 + 24 * 3);
    }

    #[test]
    fn gimbal_lock_keeps_the_rotation() {
        for x in [90.0, -90.0] {
            let locked = from_euler_zxy_deg([30.0, x, 40.0]);
            let again = from_euler_zxy_deg(euler_zxy_deg(&locked));
            assert!(locked.angle_to_rad(&again) < 1e-5);
        }
    }

    proptest! {
        #[test]
        fn euler_angles_give_the_rotation_back(
            vector in prop::array::uniform3(-1.8..1.8f64)
        ) {
            let rotation = Rotation::from_rotation_vector(vector);
            let again = from_euler_zxy_deg(euler_zxy_deg(&rotation));
            prop_assert!(rotation.angle_to_rad(&again) < 1e-6);
        }
    }
}
