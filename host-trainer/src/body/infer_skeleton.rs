//! Joint positions without a tree → the tree that explains them.
//!
//! In:  positions of a [`ClipSet`](crate::clip::ClipSet) whose source names no skeleton.
//! Out: [`Skeleton`] with zero offsets to `represent`.
//!
//! Method: a minimum spanning tree from joint 0 whose edge cost is the mean distance of two joints,
//! made dearer by how much that distance varies within a clip. Bones are short and rigid; two
//! joints of one rigid part (both hips) are rigid too but farther apart, two joints that meet by
//! chance are close but not rigid.
//! Siblings that are closer to each other than to their parent are chained: as rigid, but not anatomy.

use std::path::Path;

use crate::body::rotation::{Vector, length, subtract};
use crate::body::skeleton::Skeleton;
use crate::error::{Error, Result};

/// How many times its length a pair costs more for each part of relative variation: 1 % of
/// variation adds one half.
const VARIATION_COST: f64 = 50.0;

/// Infers the tree; every clip weighs by its frames.
///
/// # Errors
/// A joint that comes before its parent in the clips' order: the tree has to be given by hand.
pub fn infer_skeleton(
    source: &Path,
    names: Vec<String>,
    joints: &[Vec<Vec<Vector>>],
) -> Result<Skeleton> {
    let offsets = vec![[0.0; 3]; names.len()];
    let skeleton = Skeleton { offsets, parents: infer_parents(names.len(), joints), names };
    skeleton.check(source).map_err(|error| {
        Error::bad_input(
            source,
            "skeleton",
            format!("not inferable ({error})"),
            "joints listed parents first",
            "give the tree with --skeleton FILE",
        )
    })?;
    Ok(skeleton)
}

/// The tree alone, in whatever order the joints come. // (clip, frame, joint) → (joint)
pub fn infer_parents(joint_count: usize, joints: &[Vec<Vec<Vector>>]) -> Vec<Option<usize>> {
    let costs: Vec<Vec<f64>> = (0..joint_count)
        .map(|a| (0..joint_count).map(|b| pair_cost(joints, a, b)).collect())
        .collect();
    spanning_tree(&costs)
}

/// Mean distance of two joints, times 1 + variation within clips relative to it.
fn pair_cost(joints: &[Vec<Vec<Vector>>], a: usize, b: usize) -> f64 {
    let (mut total, mut squares, mut frame_count) = (0.0, 0.0, 0.0);
    for frames in joints.iter().filter(|frames| !frames.is_empty()) {
        let distances = || frames.iter().map(|p| length(subtract(p[a], p[b])));
        let mean = distances().sum::<f64>() / frames.len() as f64;
        squares += distances().map(|distance| (distance - mean).powi(2)).sum::<f64>();
        total += mean * frames.len() as f64;
        frame_count += frames.len() as f64;
    }
    let deviation = (squares / f64::max(frame_count, 1.0)).sqrt();
    total / f64::max(frame_count, 1.0) + VARIATION_COST * deviation
}

/// Prim's algorithm from joint 0. // (joint, joint) → (joint)
fn spanning_tree(costs: &[Vec<f64>]) -> Vec<Option<usize>> {
    let mut parents = vec![None; costs.len()];
    let mut is_inside = vec![false; costs.len()];
    is_inside[0] = true;
    for _ in 1..costs.len() {
        let pairs = (0..costs.len()).flat_map(|from| (0..costs.len()).map(move |to| (from, to)));
        let cheapest = pairs
            .filter(|(from, to)| is_inside[*from] && !is_inside[*to])
            .min_by(|a, b| costs[a.0][a.1].total_cmp(&costs[b.0][b.1]));
        if let Some((from, to)) = cheapest {
            parents[to] = Some(from);
            is_inside[to] = true;
        }
    }
    parents
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::kinematics::forward;
    use crate::body::rotation::Rotation;

    /// Poses of the arm and trunk of a body that bends at every joint, joints listed in `order`.
    fn poses(order: &[usize]) -> Vec<Vec<Vec<Vector>>> {
        let skeleton = Skeleton {
            names: (0..5).map(|joint| joint.to_string()).collect(),
            parents: vec![None, Some(0), Some(1), Some(1), Some(3)],
            offsets: vec![[0.0; 3]; 5],
        };
        let offsets =
            [[0.0; 3], [0.0, 0.5, 0.0], [-0.1, 0.2, 0.0], [0.2, 0.1, 0.0], [0.4, 0.0, 0.0]];
        let pose = |frame: usize| -> Vec<Vector> {
            let turn = |joint: usize| ((frame * (joint + 2)) as f64 * 0.7).sin();
            let locals: Vec<Rotation> = (0..5)
                .map(|joint| Rotation::from_rotation_vector([turn(joint), turn(joint + 5), 0.3]))
                .collect();
            let positions = forward(&skeleton, &offsets, [0.0; 3], &locals);
            order.iter().map(|joint| positions[*joint]).collect()
        };
        vec![(0..50).map(pose).collect()]
    }

    fn names() -> Vec<String> {
        (0..5).map(|joint| format!("joint{joint}")).collect()
    }

    #[test]
    fn joint_listed_before_its_parent_is_refused_with_the_remedy() {
        let error = infer_skeleton(Path::new("clips"), names(), &poses(&[0, 1, 2, 4, 3]))
            .unwrap_err()
            .to_string();
        assert!(error.contains("--skeleton FILE"), "{error}");
    }

    #[test]
    fn rigid_bones_give_their_tree_back() {
        let skeleton =
            infer_skeleton(Path::new("clips"), names(), &poses(&[0, 1, 2, 3, 4])).unwrap();
        assert_eq!(skeleton.parents, [None, Some(0), Some(1), Some(1), Some(3)]);
    }
}
