//! How far a motion is from the training clip that it is most like, in millimetres: the test for copying.
//!
//! In:  crops, and all training clips.
//! Out: the distance of every crop to the nearest clip, and [`Quantiles`] of many.
//!
//! A clip is compared over the frames of the motion's own window (a shorter clip over its last window), both minus
//! their first kept root, the last pose repeated: the distance is the mean over all frames and joints of the distance
//! of a joint. A decoder sees absolute time, so the copy of a clip would be at 0 here, not at a shifted window's
//! distance.
//!
//! Why here: MMS asks the same in the space of features, which is blind to much; this needs no classifier.

use rayon::prelude::*;
use serde::Serialize;

use super::crop::Crops;
use super::real::RealMotion;
use crate::simd::vectorized;

/// Frames between two looks whether a clip can still be the nearest.
const FRAMES_PER_LOOK: usize = 6;

/// Training clips in the order x of all joints, y of all joints, z of all joints, which vectorises.
pub(super) struct TrainingClips {
    joint_count: usize,
    clips: Vec<Planar>,
}

struct Planar {
    action: usize,
    frame_count: usize,
    /// // (frame, xyz, joint)
    positions: Vec<f32>,
}

impl TrainingClips {
    pub fn new(clips: &[RealMotion], joint_count: usize) -> Self {
        let planar = |clip: &RealMotion| Planar {
            action: clip.action,
            frame_count: clip.frame_count,
            positions: planar(&clip.positions, joint_count),
        };
        Self { joint_count, clips: clips.par_iter().map(planar).collect() }
    }

    /// Millimetres from every crop to the nearest clip, without the clip `excluded` names for it. // (motion)
    pub fn nearest_mm(
        &self,
        crops: &Crops,
        actions: &[usize],
        excluded: impl Fn(usize) -> Option<usize> + Sync,
    ) -> Vec<f64> {
        let nearest = |motion: usize| {
            let positions = planar(crops.motion(motion), self.joint_count);
            let others = |&clip: &usize| excluded(motion) != Some(clip);
            // Clips of the action first: the nearest is mostly among them, and ends the others' sums early.
            let is_of_action = |&clip: &usize| self.clips[clip].action == actions[motion];
            let of_action = (0..self.clips.len()).filter(is_of_action);
            let of_others = (0..self.clips.len()).filter(|clip| !is_of_action(clip));
            let first = crops.windows[motion].first;
            let best =
                of_action.chain(of_others).filter(others).fold(f32::INFINITY, |best, clip| {
                    self.sum_below(&positions, first, crops.frame_count, &self.clips[clip], best)
                });
            1000.0 * f64::from(best) / (crops.frame_count * self.joint_count) as f64
        };
        (0..crops.motion_count()).into_par_iter().map(nearest).collect()
    }

    /// The sum of all joints' distances if it is below `best`, else `best`.
    fn sum_below(
        &self,
        motion: &[f32],
        first: usize,
        frame_count: usize,
        clip: &Planar,
        best: f32,
    ) -> f32 {
        let width = 3 * self.joint_count;
        let start = first.min(clip.frame_count.saturating_sub(frame_count));
        let root = [0, 1, 2].map(|axis| clip.positions[start * width + axis * self.joint_count]);
        let mut sum = 0.0;
        for (index, poses) in motion.chunks(FRAMES_PER_LOOK * width).enumerate() {
            for (offset, pose) in poses.chunks_exact(width).enumerate() {
                let frame = start + index * FRAMES_PER_LOOK + offset;
                let frame = frame.min(clip.frame_count - 1);
                sum += self.distance(pose, &clip.positions[frame * width..][..width], root);
            }
            if sum >= best {
                return best;
            }
        }
        sum
    }

    /// Sum of the joints' distances of one pose. // pose, other: (xyz, joint)
    fn distance(&self, pose: &[f32], other: &[f32], root: [f32; 3]) -> f32 {
        const LANES: usize = 8;
        let (x, rest) = pose.split_at(self.joint_count);
        let (y, z) = rest.split_at(self.joint_count);
        let (other_x, rest) = other.split_at(self.joint_count);
        let (other_y, other_z) = rest.split_at(self.joint_count);
        vectorized(|| {
            let mut sums = [0.0_f32; LANES];
            let joint = |index: usize| {
                let dx = x[index] - (other_x[index] - root[0]);
                let dy = y[index] - (other_y[index] - root[1]);
                let dz = z[index] - (other_z[index] - root[2]);
                (dx * dx + dy * dy + dz * dz).sqrt()
            };
            let whole = x.len() / LANES * LANES;
            for start in (0..whole).step_by(LANES) {
                for (lane, sum) in sums.iter_mut().enumerate() {
                    *sum += joint(start + lane);
                }
            }
            for index in whole..x.len() {
                sums[0] += joint(index);
            }
            sums.iter().sum()
        })
    }
}

/// (frame, joint, xyz) → (frame, xyz, joint).
fn planar(positions: &[f32], joint_count: usize) -> Vec<f32> {
    let poses = positions.chunks_exact(3 * joint_count);
    poses.flat_map(|pose| (0..3).flat_map(|axis| pose[axis..].iter().step_by(3))).copied().collect()
}

/// How distances are spread, millimetres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quantiles {
    /// The least.
    pub min: f64,
    /// 1 % are below it.
    pub p01: f64,
    /// 5 %.
    pub p05: f64,
    /// A quarter.
    pub p25: f64,
    /// Half.
    pub median: f64,
    /// Three quarters.
    pub p75: f64,
    /// 95 %.
    pub p95: f64,
    /// The greatest.
    pub max: f64,
    /// Mean of all.
    pub mean: f64,
    /// Number of distances.
    pub count: usize,
}

impl Quantiles {
    /// Nearest ranks; `None` of nothing.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |share: f64| values[(share * last as f64).round() as usize];
        Some(Self {
            min: at(0.0),
            p01: at(0.01),
            p05: at(0.05),
            p25: at(0.25),
            median: at(0.5),
            p75: at(0.75),
            p95: at(0.95),
            max: at(1.0),
            mean: values.iter().sum::<f64>() / values.len() as f64,
            count: values.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::example::Input;
    use crate::evaluate::crop::Window;
    use crate::evaluate::real::RealMotions;
    use crate::evaluate::specimen::clip_set;

    fn real() -> RealMotions {
        RealMotions::new(&clip_set(&[("bow", 6), ("nod", 5)], 30), None).unwrap()
    }

    fn crops_of(real: &RealMotions, first: usize, frame_count: usize) -> Crops {
        let mut crops = Crops::new(frame_count, 9, Input::Joints);
        for clip in &real.training {
            let count = frame_count.min(clip.frame_count - first);
            let window = Window { first, count };
            crops.push(window, &clip.positions[first * 9..(first + count) * 9]);
        }
        crops
    }

    fn actions(real: &RealMotions) -> Vec<usize> {
        real.training.iter().map(|clip| clip.action).collect()
    }

    #[test]
    fn copy_of_a_clip_is_at_zero_in_every_window() {
        let real = real();
        let clips = TrainingClips::new(&real.training, 3);
        for (first, frame_count) in [(0, 20), (7, 20), (0, 50)] {
            let crops = crops_of(&real, first, frame_count);
            let distances = clips.nearest_mm(&crops, &actions(&real), |_| None);
            assert!(distances.iter().all(|&distance| distance < 1e-3), "{first} {frame_count}");
        }
    }

    #[test]
    fn excluded_clip_is_not_the_nearest() {
        let real = real();
        let clips = TrainingClips::new(&real.training, 3);
        let distances = clips.nearest_mm(&crops_of(&real, 0, 20), &actions(&real), Some);
        assert!(distances.iter().all(|&distance| distance > 10.0), "{distances:?}");
    }

    #[test]
    fn distance_is_the_mean_over_frames_and_joints() {
        let real = real();
        let clips = TrainingClips::new(&real.training[..1], 3);
        let mut crops = crops_of(&real, 0, 20);
        let len = crops.motion_len();
        crops.positions.truncate(len);
        crops.windows.truncate(1);
        // One of three joints is 3 cm and 4 cm away, in half of the frames.
        for pose in crops.positions.chunks_exact_mut(9).take(10) {
            pose[3] += 0.03;
            pose[5] += 0.04;
        }
        let distance = clips.nearest_mm(&crops, &[0], |_| None)[0];
        assert!((distance - 50.0 / 6.0).abs() < 1e-3, "{distance}");
    }

    #[test]
    fn quantiles_are_in_order_and_of_nothing_none() {
        assert_eq!(Quantiles::of(Vec::new()), None);
        let quantiles = Quantiles::of((0..=100).rev().map(f64::from).collect()).unwrap();
        let found = [quantiles.min, quantiles.p05, quantiles.median, quantiles.p95, quantiles.max];
        assert_eq!(found, [0.0, 5.0, 50.0, 95.0, 100.0]);
        assert_eq!(quantiles.mean, 50.0);
    }
}
