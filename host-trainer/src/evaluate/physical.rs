//! How motions move, in metres and seconds: figures that need no classifier and that an animator would name.
//!
//! In:  [`Crops`], generated or real, and a [`Ruler`] that was read off the real ones.
//! Out: a [`Sample`] a figure, whose distribution `distribution` sums up and compares with the real one.
//!
//! Why here: a classifier is blind to what it never had to tell apart. Feet that slide, limbs that stretch and hands
//! that tremble leave FID where it was.
//!
//! Sources, formula by formula:
//! * speed and jerk: first and third difference over the frame period, of every joint at every frame; jerk as the
//!   measure of smoothness is Flash and Hogan's, 1985.
//! * skating: speed over the ground of feet that are down, weighted by how far down they are, 2 − 2^(h/H) at height
//!   h ≤ H: Zhang et al., Mode-Adaptive Neural Networks, SIGGRAPH 2018. Their H is 2.5 cm for one quadruped; ours is
//!   a share of the body's height.
//! * bone error: standard deviation of a bone's length over a motion, relative to its mean, mean over the bones.
//! * drift: distance of the root between first and last frame. It is no error: only its distribution can be wrong.

pub mod distribution;
pub mod figures;
pub mod ruler;

use rayon::prelude::*;

use super::crop::Crops;
use crate::body::rotation::{Vector, dot, length, subtract};
use ruler::Ruler;

/// Figures of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Speed of joints, m/s.
    Speed,
    /// Jerk of joints, m/s³.
    Jerk,
    /// Speed over the ground of feet that are down, m/s, one a motion.
    Skating,
    /// Spread of bone lengths over a motion, percent of the length, one a motion.
    BoneError,
    /// Distance of the root between first and last frame, m, one a motion.
    Drift,
}

/// All of them, in the order of the report.
pub const QUANTITIES: [Quantity; 5] =
    [Quantity::Speed, Quantity::Jerk, Quantity::Skating, Quantity::BoneError, Quantity::Drift];

/// Values of one quantity over a set of motions; none when no motion is long enough for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Ascending; of many values as many as tell the distribution, evenly spaced by rank.
    values: Vec<f32>,
    /// Mean of all values.
    mean: f64,
}

impl Sample {
    /// Values that are kept: a repetition has millions, and every repetition is kept.
    const VALUES_MAX: usize = 1 << 16;

    /// Puts values in order.
    pub fn new(mut values: Vec<f32>) -> Self {
        values.sort_unstable_by(f32::total_cmp);
        let count = values.len();
        let mean = values.iter().map(|value| f64::from(*value)).sum::<f64>() / count.max(1) as f64;
        if count > Self::VALUES_MAX {
            let middle = |rank: usize| values[(2 * rank + 1) * count / (2 * Self::VALUES_MAX)];
            values = (0..Self::VALUES_MAX).map(middle).collect();
        }
        Self { values, mean }
    }
}

/// Measures one quantity; poses that only repeat the last one do not count.
pub fn measure(quantity: Quantity, crops: &Crops, ruler: &Ruler) -> Sample {
    let of_motion = |index: usize| {
        let len = crops.windows[index].count * crops.channel_count;
        values(quantity, &Motion::new(&crops.motion(index)[..len], crops.channel_count), ruler)
    };
    Sample::new((0..crops.motion_count()).into_par_iter().flat_map_iter(of_motion).collect())
}

fn values(quantity: Quantity, motion: &Motion<'_>, ruler: &Ruler) -> Vec<f32> {
    match quantity {
        Quantity::Speed => motion.differences(1, ruler.rate_hz),
        Quantity::Jerk => motion.differences(3, ruler.rate_hz),
        Quantity::Skating => motion.skating(ruler).into_iter().collect(),
        Quantity::BoneError => motion.bone_error(&ruler.bones).into_iter().collect(),
        Quantity::Drift => motion.drift().into_iter().collect(),
    }
}

/// Joint positions of one motion.
struct Motion<'a> {
    /// // (frame, joint · 3)
    positions: &'a [f32],
    channel_count: usize,
}

impl<'a> Motion<'a> {
    fn new(positions: &'a [f32], channel_count: usize) -> Self {
        Self { positions, channel_count }
    }

    fn frame_count(&self) -> usize {
        self.positions.len() / self.channel_count
    }

    fn joint(&self, frame: usize, joint: usize) -> Vector {
        let start = frame * self.channel_count + 3 * joint;
        std::array::from_fn(|axis| f64::from(self.positions[start + axis]))
    }

    /// Length of the `order`-th difference of every joint, over the frame period to that power.
    fn differences(&self, order: usize, rate_hz: f64) -> Vec<f32> {
        // Binomial coefficients with alternating signs, newest frame first.
        let factors: &[f64] = match order {
            1 => &[1.0, -1.0],
            _ => &[1.0, -3.0, 3.0, -1.0],
        };
        let scale = rate_hz.powi(order as i32);
        let joints = 0..self.channel_count / 3;
        let of_frame = |frame: usize| {
            joints.clone().map(move |joint| {
                let mut sum = [0.0; 3];
                for (back, factor) in factors.iter().enumerate() {
                    let position = self.joint(frame - back, joint);
                    sum.iter_mut().zip(position).for_each(|(sum, value)| *sum += factor * value);
                }
                (scale * length(sum)) as f32
            })
        };
        (order..self.frame_count()).flat_map(of_frame).collect()
    }

    /// Weighted mean speed over the ground of feet that are down; `None` when none ever is.
    fn skating(&self, ruler: &Ruler) -> Option<f32> {
        let heights = |frame: usize| {
            ruler.feet.iter().map(move |foot| (*foot, dot(self.joint(frame, *foot), ruler.up)))
        };
        let floor = floor((0..self.frame_count()).flat_map(heights).map(|(_, height)| height));
        let (mut sum, mut weights) = (0.0, 0.0);
        for frame in 1..self.frame_count() {
            for (foot, height) in heights(frame) {
                let share = ((height - floor) / ruler.contact_height_m).max(0.0);
                let weight = if share < 1.0 { 2.0 - share.exp2() } else { 0.0 };
                let step = subtract(self.joint(frame, foot), self.joint(frame - 1, foot));
                let rise = dot(step, ruler.up);
                let along = (dot(step, step) - rise * rise).max(0.0).sqrt();
                sum += weight * along * ruler.rate_hz;
                weights += weight;
            }
        }
        (weights > 0.0).then(|| (sum / weights) as f32)
    }

    /// Percent.
    fn bone_error(&self, bones: &[(usize, usize)]) -> Option<f32> {
        let count = self.frame_count() as f64;
        let of_bone = |&(a, b): &(usize, usize)| {
            let lengths = (0..self.frame_count())
                .map(|frame| length(subtract(self.joint(frame, a), self.joint(frame, b))));
            let mean = lengths.clone().sum::<f64>() / count;
            let variance = lengths.map(|length| (length - mean).powi(2)).sum::<f64>() / count;
            // Two joints of a source may be one point; that is no bone.
            if mean > 0.0 { Some(variance.sqrt() / mean) } else { None }
        };
        let errors: Vec<f64> = bones.iter().filter_map(of_bone).collect();
        let sum: f64 = errors.iter().sum();
        (!errors.is_empty()).then(|| (100.0 * sum / errors.len() as f64) as f32)
    }

    fn drift(&self) -> Option<f32> {
        let last = self.frame_count().checked_sub(1)?;
        Some(length(subtract(self.joint(last, 0), self.joint(0, 0))) as f32)
    }
}

/// Where feet stand: low, but not the one lowest value, which may be noise.
fn floor(heights: impl Iterator<Item = f64>) -> f64 {
    /// Share of a motion's foot heights that lie below its floor.
    const BELOW: f64 = 0.05;
    let mut heights: Vec<f64> = heights.collect();
    heights.sort_unstable_by(f64::total_cmp);
    heights.get((BELOW * heights.len() as f64) as usize).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::example::Input;
    use crate::evaluate::crop::Window;

    const RATE_HZ: f64 = 20.0;

    fn ruler() -> Ruler {
        Ruler {
            up: [0.0, -1.0, 0.0], // Down is +y, as cameras see it.
            feet: vec![1],
            bones: vec![(0, 1)],
            contact_height_m: 0.05,
            rate_hz: RATE_HZ,
        }
    }

    /// One motion of two joints, by time in seconds; followed by waiting poses.
    fn crops(frame_count: usize, joints: impl Fn(f64) -> [[f64; 3]; 2]) -> Crops {
        let poses = (0..frame_count).flat_map(|frame| joints(frame as f64 / RATE_HZ));
        let positions: Vec<f32> = poses.flatten().map(|value| value as f32).collect();
        let mut crops = Crops::new(frame_count + 10, 6, Input::Joints);
        crops.push(Window { first: 0, count: frame_count }, &positions);
        crops
    }

    fn values(quantity: Quantity, crops: &Crops) -> Vec<f32> {
        measure(quantity, crops, &ruler()).values
    }

    fn assert_all(values: &[f32], count: usize, expected: f64) {
        assert_eq!(values.len(), count);
        let is_close = |value: &f32| (f64::from(*value) - expected).abs() < 1e-3 * (1.0 + expected);
        assert!(values.iter().all(is_close), "{values:?}, expected {expected}");
    }

    #[test]
    fn motion_too_short_for_a_difference_has_none() {
        let still = |_| [[0.0; 3], [0.0, 1.0, 0.0]];
        assert!(values(Quantity::Jerk, &crops(3, still)).is_empty());
        assert!(values(Quantity::Speed, &crops(1, still)).is_empty());
        assert!(values(Quantity::Skating, &crops(1, still)).is_empty());
    }

    #[test]
    fn uniform_motion_has_its_speed_no_jerk_and_drifts() {
        let walk = |t: f64| [[3.0 * t, 0.0, 4.0 * t], [3.0 * t, 1.0, 4.0 * t]];
        let crops = crops(21, walk);
        assert_all(&values(Quantity::Speed, &crops), 20 * 2, 5.0);
        assert_all(&values(Quantity::Drift, &crops), 1, 5.0);
        // Third differences of f32 positions of some metres, over (1/20 s)³.
        assert!(values(Quantity::Jerk, &crops).iter().all(|jerk| *jerk < 0.05));
    }

    #[test]
    fn cubic_motion_has_its_jerk() {
        let throw = |t: f64| [[t.powi(3), 0.0, 0.0], [0.0, t.powi(3), 0.0]];
        let jerk = values(Quantity::Jerk, &crops(11, throw));
        assert_eq!(jerk.len(), 8 * 2);
        assert!(jerk.iter().all(|jerk| (jerk - 6.0).abs() < 0.05), "{jerk:?}");
    }

    #[test]
    fn foot_that_slides_skates_with_its_speed_and_one_that_stands_does_not() {
        let slide = |t: f64| [[0.0; 3], [0.6 * t, 1.0, 0.8 * t]];
        assert_all(&values(Quantity::Skating, &crops(20, slide)), 1, 1.0);
        let stand = |t: f64| [[t, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_all(&values(Quantity::Skating, &crops(20, stand)), 1, 0.0);
    }

    #[test]
    fn foot_in_the_air_may_move() {
        // Down for a second, then 20 cm up and fast.
        let step = |t: f64| {
            let foot = if t < 1.0 { [0.0, 1.0, 0.0] } else { [2.0 * t, 0.8, 0.0] };
            [[0.0; 3], foot]
        };
        assert_all(&values(Quantity::Skating, &crops(40, step)), 1, 0.0);
    }

    #[test]
    fn bone_that_alternates_has_its_deviation_and_a_rigid_one_none() {
        let turn = |t: f64| [[0.0; 3], [t.cos(), t.sin(), 0.0]];
        assert!(values(Quantity::BoneError, &crops(20, turn))[0] < 1e-4);
        let stretch = |t: f64| {
            let is_even = ((t * RATE_HZ).round() as usize).is_multiple_of(2);
            [[0.0; 3], [if is_even { 1.1 } else { 0.9 }, 0.0, 0.0]]
        };
        assert_all(&values(Quantity::BoneError, &crops(20, stretch)), 1, 10.0);
    }
}
