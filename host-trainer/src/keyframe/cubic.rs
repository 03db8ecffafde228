//! Cubic curves between samples: each as long as the tolerance allows, the slopes at its ends by least squares.
//!
//! Slopes of neighbours are free of each other, as handles are in animation programs: that needs the fewest curves.
//! Source: Hermite's form of a cubic; greedy as in Schneider, "An algorithm for automatically fitting digitized
//! curves", Graphics Gems, 1990, in one dimension, where the time of every sample is known.

/// How strongly a slope is held to that of the samples around it; decides only where samples are too few to.
const SLOPE_WEIGHT: f64 = 1e-4;

/// A cubic from one sample to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    /// Sample where it begins.
    pub first: usize,
    /// Sample where it ends.
    pub last: usize,
    /// Values there.
    pub values: [f64; 2],
    /// Slopes there, per sample.
    pub slopes: [f64; 2],
}

impl Cubic {
    /// The value at a sample, whole or not, between `first` and `last`.
    pub fn at(&self, sample: f64) -> f64 {
        let length = (self.last - self.first) as f64;
        let [h00, h10, h01, h11] = hermite((sample - self.first as f64) / length);
        let [from, to] = self.values;
        h00 * from + h01 * to + length * (h10 * self.slopes[0] + h11 * self.slopes[1])
    }
}

/// The fewest curves that a greedy search finds; none for fewer than two samples.
///
/// No sample is farther than `tolerance` from its curve.
pub fn fit(values: &[f64], tolerance: f64) -> Vec<Cubic> {
    let mut curves: Vec<Cubic> = Vec::new();
    let mut first = 0;
    while first + 1 < values.len() {
        let curve = longest(values, first, tolerance);
        first = curve.last;
        curves.push(curve);
    }
    curves
}

/// The curves at every sample.
pub fn play(curves: &[Cubic]) -> Vec<f64> {
    let start = curves.first().map(|curve| curve.values[0]);
    let rest = curves
        .iter()
        .flat_map(|curve| (curve.first + 1..=curve.last).map(|sample| curve.at(sample as f64)));
    start.into_iter().chain(rest).collect()
}

/// Doubles the length until the tolerance breaks, then halves in on the longest that holds.
fn longest(values: &[f64], first: usize, tolerance: f64) -> Cubic {
    let end = values.len() - 1;
    // Two samples always fit.
    let mut best = between(values, first, first + 1);
    let mut length = 2;
    let mut refused = end + 1;
    while first + length <= end {
        let curve = between(values, first, first + length);
        if error(values, &curve) > tolerance {
            refused = first + length;
            break;
        }
        best = curve;
        length *= 2;
    }
    while best.last + 1 < refused {
        let curve = between(values, first, best.last.midpoint(refused).max(best.last + 1));
        if error(values, &curve) > tolerance {
            refused = curve.last;
        } else {
            best = curve;
        }
    }
    best
}

fn error(values: &[f64], curve: &Cubic) -> f64 {
    let errors = (curve.first..=curve.last).map(|at| (values[at] - curve.at(at as f64)).abs());
    errors.fold(0.0, f64::max)
}

/// The curve through two samples whose slopes leave the least squared error at the samples between.
fn between(values: &[f64], first: usize, last: usize) -> Cubic {
    let length = (last - first) as f64;
    let [from, to] = [values[first], values[last]];
    // Unknown: slopes over the whole length. Normal equations of the errors and of the pull towards the samples' own.
    let pull = [slope(values, first) * length, slope(values, last) * length];
    let (mut a, mut b, mut c) = (SLOPE_WEIGHT, 0.0, SLOPE_WEIGHT);
    let (mut p, mut q) = (SLOPE_WEIGHT * pull[0], SLOPE_WEIGHT * pull[1]);
    for (step, value) in (1..).zip(&values[first + 1..last]) {
        let [h00, h10, h01, h11] = hermite(f64::from(step) / length);
        let rest = value - h00 * from - h01 * to;
        (a, b, c) = (a + h10 * h10, b + h10 * h11, c + h11 * h11);
        (p, q) = (p + h10 * rest, q + h11 * rest);
    }
    let determinant = a * c - b * b;
    let slopes = [(p * c - q * b) / determinant, (q * a - p * b) / determinant];
    Cubic { first, last, values: [from, to], slopes: slopes.map(|slope| slope / length) }
}

/// Central difference, one-sided at the ends.
fn slope(values: &[f64], at: usize) -> f64 {
    let (before, after) = (at.saturating_sub(1), (at + 1).min(values.len() - 1));
    (values[after] - values[before]) / (after - before) as f64
}

/// The basis functions of value, slope, value, slope.
fn hermite(u: f64) -> [f64; 4] {
    let (squared, cubed) = (u * u, u * u * u);
    [
        2.0 * cubed - 3.0 * squared + 1.0,
        cubed - 2.0 * squared + u,
        3.0 * squared - 2.0 * cubed,
        cubed - squared,
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn too_few_samples_have_no_curve() {
        assert_eq!((fit(&[], 1.0), fit(&[3.0], 1.0)), (Vec::new(), Vec::new()));
        assert_eq!(play(&[]), Vec::<f64>::new());
    }

    #[test]
    fn a_cubic_is_one_curve() {
        let cubic = |at: f64| 0.001 * at * at * at - 0.05 * at * at + at;
        let values: Vec<f64> = (0..60).map(|at| cubic(f64::from(at))).collect();
        let curves = fit(&values, 0.01);
        assert_eq!(curves.len(), 1);
        assert!((curves[0].at(30.5) - cubic(30.5)).abs() < 0.01);
    }

    #[test]
    fn a_swing_takes_fewer_cubics_than_lines() {
        let values: Vec<f64> = (0..200).map(|at| 30.0 * (f64::from(at) / 16.0).sin()).collect();
        let lines = crate::keyframe::linear::keys(&values, 0.5).len();
        assert!(fit(&values, 0.5).len() * 2 < lines);
    }

    proptest! {
        #[test]
        fn no_sample_is_farther_than_the_tolerance(
            values in prop::collection::vec(-90.0..90.0f64, 2..80), tolerance in 0.1..30.0f64
        ) {
            let played = play(&fit(&values, tolerance));
            prop_assert_eq!(played.len(), values.len());
            prop_assert!(played.iter().zip(&values).all(|(a, b)| (a - b).abs() <= tolerance + 1e-9));
        }
    }
}
