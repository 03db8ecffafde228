//! A figure that depends on draws: its mean over the repetitions, and how far to trust it.
//!
//! In:  one value a repetition.
//! Out: [`Estimate`], into every row.

use serde::Serialize;

/// Mean of the repetitions with the half width of its 95 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Mean over the repetitions.
    pub mean: f64,
    /// 1.96 standard deviations of the mean; 0 for one repetition, where nothing is known of it.
    ///
    /// Source: the formula of Action2Motion and MotionINR, with the unbiased deviation.
    pub ci95: f64,
}

impl Estimate {
    /// Of one value a repetition; at least one.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.into_iter().collect();
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = if values.len() < 2 { 0.0 } else { (squares / (count - 1.0)).sqrt() };
        Self { mean, ci95: 1.96 * deviation / count.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_repetition_has_no_interval() {
        assert_eq!(Estimate::of([3.0]), Estimate { mean: 3.0, ci95: 0.0 });
    }

    #[test]
    fn interval_is_the_papers() {
        let estimate = Estimate::of([1.0, 2.0, 3.0, 4.0]);
        assert_eq!(estimate.mean, 2.5);
        // Unbiased variance of 1, 2, 3, 4 is 5/3.
        assert!((estimate.ci95 - 1.96 * (5.0_f64 / 3.0).sqrt() / 2.0).abs() < 1e-15);
    }
}
