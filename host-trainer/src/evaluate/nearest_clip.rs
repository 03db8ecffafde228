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
/// Joints that are computed side by side.
const LANES: usize = 8;
/// What rounding may add to a bound, relative to it and in metres.
const BOUND_SLACK: (f32, f32) = (1e-3, 1e-3);

/// Training clips in the order x of all joints, y of all joints, z of all joints, which vectorises.
pub(super) struct TrainingClips {
    joint_count: usize,
    clips: Vec<Planar>,
}

struct Planar {
    frame_count: usize,
    /// // (frame, xyz, joint)
    positions: Vec<f32>,
    /// Sums of the positions of all frames before each, and of all. // (frame + 1, xyz, joint)
    sums: Vec<f64>,
}

/// A clip that may be the nearest.
struct Candidate {
    clip: usize,
    /// No sum of distances is below it.
    bound: f32,
}

impl TrainingClips {
    pub fn new(clips: &[RealMotion], joint_count: usize) -> Self {
        let planar = |clip: &RealMotion| {
            let positions = planar(&clip.positions, joint_count);
            Planar {
                frame_count: clip.frame_count,
                sums: running_sums(&positions, 3 * joint_count),
                positions,
            }
        };
        Self { joint_count, clips: clips.par_iter().map(planar).collect() }
    }

    /// Millimetres from every crop to the nearest clip, without the clip `excluded` names for it. // (motion)
    pub fn nearest_mm(
        &self,
        crops: &Crops,
        excluded: impl Fn(usize) -> Option<usize> + Sync,
    ) -> Vec<f64> {
        let nearest = |motion: usize| {
            let positions = planar(crops.motion(motion), self.joint_count);
            let first = crops.windows[motion].first;
            let candidates = self.candidates(&positions, first, crops.frame_count);
            let others = candidates.iter().filter(|other| excluded(motion) != Some(other.clip));
            let best = others.fold(f32::INFINITY, |best, candidate| {
                if candidate.bound >= best {
                    return best;
                }
                self.sum_below(&positions, first, crops.frame_count, candidate.clip, best)
            });
            1000.0 * f64::from(best) / (crops.frame_count * self.joint_count) as f64
        };
        (0..crops.motion_count()).into_par_iter().map(nearest).collect()
    }

    /// All clips, the least bound first. The mean distance of a joint over the frames is never less than the
    /// distance of its mean positions.
    fn candidates(&self, motion: &[f32], first: usize, frame_count: usize) -> Vec<Candidate> {
        let width = 3 * self.joint_count;
        let sums = running_sums(motion, width);
        let mean = |sum: &f64| (sum / frame_count as f64) as f32;
        let own: Vec<f32> = sums[sums.len() - width..].iter().map(mean).collect();
        let mut other = vec![0.0; width];
        let bound_of = |(clip, planar): (usize, &Planar)| {
            let start = planar.start(first, frame_count);
            planar.mean(start, frame_count, &mut other);
            let distance = sum_of_distances(&own, &other, planar.root(start, self.joint_count));
            let bound = distance * frame_count as f32;
            Candidate { clip, bound: bound * (1.0 - BOUND_SLACK.0) - BOUND_SLACK.1 }
        };
        let mut candidates: Vec<_> = self.clips.iter().enumerate().map(bound_of).collect();
        candidates.sort_by(|one, other| one.bound.total_cmp(&other.bound));
        candidates
    }

    /// The sum of all joints' distances if it is below `best`, else `best`.
    fn sum_below(
        &self,
        motion: &[f32],
        first: usize,
        frame_count: usize,
        clip: usize,
        best: f32,
    ) -> f32 {
        let (width, clip) = (3 * self.joint_count, &self.clips[clip]);
        let start = clip.start(first, frame_count);
        let root = clip.root(start, self.joint_count);
        let mut sum = 0.0;
        for (index, poses) in motion.chunks(FRAMES_PER_LOOK * width).enumerate() {
            for (offset, pose) in poses.chunks_exact(width).enumerate() {
                let frame = (start + index * FRAMES_PER_LOOK + offset).min(clip.frame_count - 1);
                sum += sum_of_distances(pose, &clip.positions[frame * width..][..width], root);
            }
            if sum >= best {
                return best;
            }
        }
        sum
    }
}

impl Planar {
    /// First frame of the window that a motion's window is compared with.
    fn start(&self, first: usize, frame_count: usize) -> usize {
        first.min(self.frame_count.saturating_sub(frame_count))
    }

    /// The root's position at a frame.
    fn root(&self, frame: usize, joint_count: usize) -> [f32; 3] {
        [0, 1, 2].map(|axis| self.positions[(3 * frame + axis) * joint_count])
    }

    /// Mean pose of a window, in which the last pose stands for the frames beyond it. // mean: (xyz, joint)
    fn mean(&self, start: usize, frame_count: usize, mean: &mut [f32]) {
        let width = mean.len();
        let end = (start + frame_count).min(self.frame_count);
        let repeated = (start + frame_count - end) as f64;
        let (before, after) = (&self.sums[start * width..], &self.sums[end * width..]);
        let last = &self.positions[(self.frame_count - 1) * width..];
        for (((mean, before), after), last) in mean.iter_mut().zip(before).zip(after).zip(last) {
            *mean = ((after - before + repeated * f64::from(*last)) / frame_count as f64) as f32;
        }
    }
}

/// Sums of the poses before each frame, and of all. // (frame + 1, width)
fn running_sums(positions: &[f32], width: usize) -> Vec<f64> {
    let mut sums = vec![0.0; width];
    for pose in positions.chunks_exact(width) {
        let before = sums.len() - width;
        for (channel, value) in pose.iter().enumerate() {
            sums.push(sums[before + channel] + f64::from(*value));
        }
    }
    sums
}

/// Sum over the joints of the distance between a pose and another minus its root. // (xyz, joint) each
fn sum_of_distances(pose: &[f32], other: &[f32], root: [f32; 3]) -> f32 {
    let ([x, y, z], [other_x, other_y, other_z]) = (axes(pose), axes(other));
    let length = |pose: [f32; 3], other: [f32; 3]| {
        let difference = [0, 1, 2].map(|axis| pose[axis] - (other[axis] - root[axis]));
        difference.iter().map(|value| value * value).sum::<f32>().sqrt()
    };
    vectorized(|| {
        let mut sums = [0.0_f32; LANES];
        let pairs = x.0.iter().zip(other_x.0).zip(y.0.iter().zip(other_y.0));
        for (((x, a), (y, b)), (z, c)) in pairs.zip(z.0.iter().zip(other_z.0)) {
            for lane in 0..LANES {
                sums[lane] += length([x[lane], y[lane], z[lane]], [a[lane], b[lane], c[lane]]);
            }
        }
        let pairs = x.1.iter().zip(other_x.1).zip(y.1.iter().zip(other_y.1));
        for (((x, a), (y, b)), (z, c)) in pairs.zip(z.1.iter().zip(other_z.1)) {
            sums[0] += length([*x, *y, *z], [*a, *b, *c]);
        }
        sums.iter().sum()
    })
}

/// x, y and z of all joints, whole registers and what is left.
fn axes(pose: &[f32]) -> [(&[[f32; LANES]], &[f32]); 3] {
    let joint_count = pose.len() / 3;
    [0, 1, 2].map(|axis| pose[axis * joint_count..][..joint_count].as_chunks())
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

    #[test]
    fn copy_of_a_clip_is_at_zero_in_every_window() {
        let real = real();
        let clips = TrainingClips::new(&real.training, 3);
        for (first, frame_count) in [(0, 20), (7, 20), (0, 50)] {
            let crops = crops_of(&real, first, frame_count);
            let distances = clips.nearest_mm(&crops, |_| None);
            assert!(distances.iter().all(|&distance| distance < 1e-3), "{first} {frame_count}");
        }
    }

    #[test]
    fn excluded_clip_is_not_the_nearest() {
        let real = real();
        let clips = TrainingClips::new(&real.training, 3);
        let distances = clips.nearest_mm(&crops_of(&real, 0, 20), Some);
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
        let distance = clips.nearest_mm(&crops, |_| None)[0];
        assert!((distance - 50.0 / 6.0).abs() < 1e-3, "{distance}");
    }

    #[test]
    fn nearest_is_that_of_all_clips_one_by_one() {
        let real = real();
        let all = TrainingClips::new(&real.training, 3);
        for (first, frame_count) in [(0, 20), (7, 20), (0, 50)] {
            let mut crops = crops_of(&real, first, frame_count);
            // So that no motion is a clip.
            for (index, value) in crops.positions.iter_mut().enumerate() {
                *value += 0.3 * (index as f32 * 0.37).sin();
            }
            let one_by_one = real
                .training
                .chunks(1)
                .map(|clip| TrainingClips::new(clip, 3).nearest_mm(&crops, |_| None));
            let least = |least: Vec<f64>, other: Vec<f64>| {
                least.iter().zip(&other).map(|(a, b)| a.min(*b)).collect::<Vec<f64>>()
            };
            let expected = one_by_one.reduce(least).unwrap();
            let found = all.nearest_mm(&crops, |_| None);
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6));
        }
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
