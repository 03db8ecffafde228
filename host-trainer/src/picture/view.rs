//! From which side a picture shows a body: found from the joints, because sources disagree on up.
//!
//! In:  joint positions of all motions of a picture; camera coordinates point y down, BVH y up, robots z up.
//! Out: [`View`] to `stick_figures`.

use crate::body::rotation::{Vector, cross, dot};
use crate::body::skeleton::Skeleton;
use crate::picture::svg::Point;

/// Joint positions of one motion. // (frame, joint)
pub type Frames = Vec<Vec<Vector>>;

/// Which axes of the clips point where; found once for a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Unit vector to the right of the picture.
    pub right: Vector,
    /// Unit vector against gravity.
    pub up: Vector,
    /// Unit vector to the viewer.
    pub viewer: Vector,
}

impl View {
    /// Up is from feet to head where joints have such names, else away from the steadier end of the
    /// body: the floor.
    pub fn of(skeleton: Option<&Skeleton>, joints: &[Frames]) -> Self {
        let named = skeleton.and_then(|skeleton| feet_to_head(skeleton, joints));
        let up = named.unwrap_or_else(|| from_the_floor(joints));
        let right = [1.0, 0.0, 0.0];
        Self { right, up, viewer: cross(right, up) }
    }

    /// Across and up.
    pub fn flat(&self, position: Vector) -> Point {
        (dot(position, self.right), dot(position, self.up))
    }
}

/// The axis, y or z, that most points from the feet to the head on average.
fn feet_to_head(skeleton: &Skeleton, joints: &[Frames]) -> Option<Vector> {
    let named = |words: &[&str]| -> Vec<usize> {
        let names = skeleton.names.iter().map(|name| name.to_lowercase()).enumerate();
        names
            .filter(|(_, name)| words.iter().any(|word| name.contains(word)))
            .map(|(joint, _)| joint)
            .collect()
    };
    let (heads, feet) = (named(&["head"]), named(&["foot", "ankle", "toe"]));
    if heads.is_empty() || feet.is_empty() {
        return None;
    }
    let mean = |set: &[usize], axis: usize| -> f64 {
        let values = joints.iter().flatten().flat_map(|p| set.iter().map(move |j| p[*j][axis]));
        values.clone().sum::<f64>() / values.count().max(1) as f64
    };
    let rise = |axis: usize| mean(&heads, axis) - mean(&feet, axis);
    let axis = if rise(1).abs() >= rise(2).abs() { 1 } else { 2 };
    Some(axis_vector(axis, rise(axis)))
}

/// The longer of the axes y and z, away from the end whose coordinate varies less over time.
fn from_the_floor(joints: &[Frames]) -> Vector {
    let extremes = |axis: usize| -> Vec<Point> {
        let of_pose = |pose: &Vec<Vector>| {
            pose.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
                (low.min(p[axis]), high.max(p[axis]))
            })
        };
        joints.iter().flatten().map(of_pose).collect()
    };
    let length = |axis: usize| extremes(axis).iter().map(|(low, high)| high - low).sum::<f64>();
    let axis = if length(1) >= length(2) { 1 } else { 2 };
    let spread = |values: Vec<f64>| {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.iter().map(|value| (value - mean).powi(2)).sum::<f64>()
    };
    let (low, high): (Vec<f64>, Vec<f64>) = extremes(axis).into_iter().unzip();
    axis_vector(axis, spread(high) - spread(low))
}

fn axis_vector(axis: usize, sign: f64) -> Vector {
    std::array::from_fn(|k| if k == axis { if sign < 0.0 { -1.0 } else { 1.0 } } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Head and foot of a jumper, `up` pointing against gravity: the foot comes back to the floor, the head bends.
    fn jumper(up: Vector) -> Vec<Frames> {
        let at = |height: f64| up.map(|element| element * height);
        let heights = [(0.0, 1.7), (0.0, 1.2), (0.0, 1.6), (0.1, 1.75)];
        vec![heights.iter().map(|(foot, head)| vec![at(*foot), at(*head)]).collect()]
    }

    #[test]
    fn up_is_found_with_and_without_names() {
        let skeleton = Skeleton {
            names: vec!["left_foot".to_owned(), "Head".to_owned()],
            parents: vec![None, Some(0)],
            offsets: vec![[0.0; 3]; 2],
        };
        for up in [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]] {
            assert_eq!(View::of(Some(&skeleton), &jumper(up)).up, up);
            assert_eq!(View::of(None, &jumper(up)).up, up);
        }
    }

    #[test]
    fn viewer_stands_before_a_camera_and_before_a_robot() {
        let camera = View::of(None, &jumper([0.0, -1.0, 0.0]));
        assert_eq!(camera.viewer, [0.0, 0.0, -1.0]);
        let robot = View::of(None, &jumper([0.0, 0.0, 1.0]));
        assert_eq!(robot.viewer, [0.0, -1.0, 0.0]);
    }
}
