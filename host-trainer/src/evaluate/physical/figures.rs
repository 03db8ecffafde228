//! All quantities of a set of motions, summed up over the repetitions.
//!
//! In:  [`Samples`] of generated and of real motions, once a repetition.
//! Out: [`PhysicalFigures`], into the report.

use serde::Serialize;

use super::distribution::Summary;
use super::ruler::Ruler;
use super::{QUANTITIES, Quantity, Sample, measure};
use crate::evaluate::crop::Crops;
use crate::evaluate::estimate::Estimate;

/// A sample of every quantity, in the order of `QUANTITIES`.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples([Sample; QUANTITIES.len()]);

impl Samples {
    /// Measures a set of motions.
    pub fn new(crops: &Crops, ruler: &Ruler) -> Self {
        Self(QUANTITIES.map(|quantity| measure(quantity, crops, ruler)))
    }

    /// The figures of one repetition, compared with the real motions of the same one.
    pub fn summarize(&self, real: &Self) -> Summaries {
        let pair = |index: usize| Summary::new(&self.0[index], &real.0[index]);
        Summaries(std::array::from_fn(pair))
    }
}

/// What one repetition found, in the order of `QUANTITIES`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summaries([Option<Summary>; QUANTITIES.len()]);

/// Figures in metres and seconds; `None` where no motion is long enough for one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhysicalFigures {
    /// Speed of every joint at every frame.
    pub joint_speed_m_per_s: Option<Distribution>,
    /// Jerk of every joint at every frame.
    pub joint_jerk_m_per_s3: Option<Distribution>,
    /// Speed over the ground of feet that are down, one value a motion.
    pub foot_skating_m_per_s: Option<Distribution>,
    /// Spread of bone lengths over a motion, percent of the length, one value a motion.
    pub bone_length_error_percent: Option<Distribution>,
    /// Distance of the root between first and last frame, one value a motion.
    pub root_drift_m: Option<Distribution>,
}

/// A distribution in four numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distribution {
    /// Mean.
    pub mean: Estimate,
    /// Half of the values lie below it.
    pub median: Estimate,
    /// 95 % of the values lie below it.
    pub percentile_95: Estimate,
    /// 1-Wasserstein distance to the training clips' values.
    pub distance_to_real: Estimate,
}

impl PhysicalFigures {
    /// Means and intervals over the repetitions.
    pub fn new(repetitions: &[Summaries]) -> Self {
        let of = |quantity| distribution(repetitions, quantity);
        Self {
            joint_speed_m_per_s: of(Quantity::Speed),
            joint_jerk_m_per_s3: of(Quantity::Jerk),
            foot_skating_m_per_s: of(Quantity::Skating),
            bone_length_error_percent: of(Quantity::BoneError),
            root_drift_m: of(Quantity::Drift),
        }
    }

    /// Name with unit, decimals that tell something, and the distribution, in the order of the report.
    pub fn rows(&self) -> [(&'static str, usize, Option<Distribution>); QUANTITIES.len()] {
        [
            ("joint speed, m/s", 3, self.joint_speed_m_per_s),
            ("joint jerk, m/s³", 1, self.joint_jerk_m_per_s3),
            ("foot skating, m/s", 3, self.foot_skating_m_per_s),
            ("bone length error, %", 2, self.bone_length_error_percent),
            ("root drift, m", 3, self.root_drift_m),
        ]
    }
}

fn distribution(repetitions: &[Summaries], quantity: Quantity) -> Option<Distribution> {
    let summaries: Vec<Summary> =
        repetitions.iter().filter_map(|summaries| summaries.0[quantity as usize]).collect();
    let estimate = |of: fn(&Summary) -> f64| Estimate::of(summaries.iter().map(of));
    (!summaries.is_empty()).then(|| Distribution {
        mean: estimate(|summary| summary.mean),
        median: estimate(|summary| summary.median),
        percentile_95: estimate(|summary| summary.percentile_95),
        distance_to_real: estimate(|summary| summary.distance),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::example::Input;
    use crate::evaluate::crop::Window;
    use crate::evaluate::real::RealMotions;
    use crate::evaluate::specimen;

    #[test]
    fn real_motions_are_no_distance_from_themselves_and_faster_ones_are() {
        let real = RealMotions::new(&specimen::clip_set(&[("nod", 5)], 20), None).unwrap();
        let ruler = Ruler::new(&real);
        let samples = |factor: f32| {
            let mut crops = Crops::new(30, 9, Input::Joints);
            for clip in &real.training {
                let poses: Vec<f32> = clip.positions.iter().map(|value| value * factor).collect();
                crops.push(Window { first: 0, count: clip.frame_count }, &poses);
            }
            Samples::new(&crops, &ruler)
        };
        let same = samples(1.0);
        let figures = PhysicalFigures::new(&[same.summarize(&same); 2]);
        let speed = figures.joint_speed_m_per_s.unwrap();
        assert_eq!(speed.distance_to_real, Estimate { mean: 0.0, ci95: 0.0 });
        let faster = PhysicalFigures::new(&[samples(1.5).summarize(&same)]);
        let faster_speed = faster.joint_speed_m_per_s.unwrap();
        assert!((faster_speed.mean.mean / speed.mean.mean - 1.5).abs() < 1e-3);
        assert!((faster_speed.distance_to_real.mean - 0.5 * speed.mean.mean).abs() < 1e-3);
        assert_eq!(figures.rows()[4].2, figures.root_drift_m);
    }
}
