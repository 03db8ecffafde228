//! A sample of one quantity in four numbers, one of them its distance to the real sample.
//!
//! In:  two [`Sample`]s.
//! Out: [`Summary`], once a repetition.
//!
//! Why here: means hide what is wrong. Motions that stand still half of the time and jump in the other half have the
//! right mean speed; the distance of the distributions tells.
//!
//! Source: Ramdas, García Trillos and Cuturi, On Wasserstein Two-Sample Testing, 2017: in one dimension the
//! 1-Wasserstein distance is the area between the quantile functions.

use super::Sample;

/// A sample, summed up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Mean.
    pub mean: f64,
    /// Half of the values lie below it.
    pub median: f64,
    /// 95 % of the values lie below it.
    pub percentile_95: f64,
    /// 1-Wasserstein distance to the real sample, in the unit of the quantity.
    pub distance: f64,
}

impl Summary {
    /// `None` when one of the samples is empty.
    pub fn new(sample: &Sample, real: &Sample) -> Option<Self> {
        if sample.values.is_empty() || real.values.is_empty() {
            return None;
        }
        Some(Self {
            mean: sample.mean,
            median: quantile(&sample.values, 0.5),
            percentile_95: quantile(&sample.values, 0.95),
            distance: wasserstein(&sample.values, &real.values),
        })
    }
}

/// The value below which this share of ascending values lies, linear between neighbours.
fn quantile(values: &[f32], share: f64) -> f64 {
    let place = share * (values.len() - 1) as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    let [low, high] = [below, (below + 1).min(values.len() - 1)].map(|i| f64::from(values[i]));
    low + part * (high - low)
}

/// Area between the quantile functions of two ascending samples, neither empty.
fn wasserstein(one: &[f32], other: &[f32]) -> f64 {
    let (mut area, mut share) = (0.0, 0.0);
    let (mut i, mut j) = (0, 0);
    while i < one.len() && j < other.len() {
        // Steps of the quantile functions are compared exactly: (i + 1) / n with (j + 1) / m.
        let (left, right) = ((i + 1) * other.len(), (j + 1) * one.len());
        let end = left.min(right) as f64 / (one.len() * other.len()) as f64;
        area += (end - share) * (f64::from(one[i]) - f64::from(other[j])).abs();
        share = end;
        i += usize::from(left <= right);
        j += usize::from(right <= left);
    }
    area
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn empty_sample_has_no_summary() {
        let (none, some) = (Sample::default(), Sample::new(vec![1.0]));
        assert_eq!(Summary::new(&none, &some), None);
        assert_eq!(Summary::new(&some, &none), None);
    }

    #[test]
    fn summary_of_a_known_sample() {
        let sample = Sample::new(vec![3.0, 1.0, 2.0, 4.0, 0.0]);
        let summary = Summary::new(&sample, &Sample::new(vec![2.0; 7])).unwrap();
        assert_eq!([summary.mean, summary.median], [2.0, 2.0]);
        assert!((summary.percentile_95 - 3.8).abs() < 1e-12);
        assert!((summary.distance - 6.0 / 5.0).abs() < 1e-12);
    }

    #[test]
    fn sample_of_millions_keeps_its_distribution() {
        let value = |index: u32| f64::from(index.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
        let uniform = |shift: f64| {
            Sample::new((0..1_000_000).map(|index| (value(index) + shift) as f32).collect())
        };
        let summary = Summary::new(&uniform(0.25), &uniform(0.0)).unwrap();
        assert!((summary.mean - 0.75).abs() < 1e-4 && (summary.median - 0.75).abs() < 1e-4);
        assert!((summary.percentile_95 - 1.2).abs() < 1e-4);
        assert!((summary.distance - 0.25).abs() < 1e-4);
    }

    proptest! {
        #[test]
        fn shifted_sample_is_the_shift_away_whatever_the_counts(
            values in prop::collection::vec(-10.0..10.0_f32, 1..40),
            copies in 1_usize..4,
            shift in -3.0..3.0_f32,
        ) {
            let one = Sample::new(values.clone());
            let shifted: Vec<f32> = values.iter().map(|value| value + shift).collect();
            let other = Sample::new(shifted.repeat(copies));
            let distance = Summary::new(&one, &other).unwrap().distance;
            prop_assert!((distance - f64::from(shift).abs()).abs() < 1e-5);
            let back = Summary::new(&other, &one).unwrap().distance;
            prop_assert!((distance - back).abs() < 1e-9);
        }
    }
}
