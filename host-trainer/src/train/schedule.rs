//! Course of the learning rates, and the budget that it ends with.
//!
//! In:  `[schedule]` and `[budget]` of the configuration; steps and seconds done so far.
//! Out: progress in 0..=1 and the factor of every learning rate.

use crate::config::{BudgetConfig, ScheduleShape};

/// Share of the budget that is used up, 0 to 1.
///
/// With minutes this is the share of time, including that of the runs before a resumption.
pub fn progress(budget: &BudgetConfig, step: u64, elapsed_s: f64) -> f64 {
    const SECONDS_PER_MINUTE: f64 = 60.0;
    let share = if budget.minutes > 0.0 {
        elapsed_s / (budget.minutes * SECONDS_PER_MINUTE)
    } else {
        step as f64 / budget.steps as f64
    };
    share.min(1.0)
}

/// Factor of the learning rates at this progress.
pub fn rate_factor(shape: ScheduleShape, progress: f64) -> f64 {
    match shape {
        ScheduleShape::Constant => 1.0,
        ScheduleShape::Cosine => 0.5 * (1.0 + (core::f64::consts::PI * progress).cos()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minutes_count_when_they_are_given_and_steps_otherwise() {
        let timed = BudgetConfig { steps: 100, minutes: 2.0 };
        let counted = BudgetConfig { steps: 100, minutes: 0.0 };
        assert_eq!(progress(&timed, 99, 30.0), 0.25);
        assert_eq!(progress(&timed, 0, 500.0), 1.0);
        assert_eq!(progress(&counted, 25, 1e9), 0.25);
    }

    #[test]
    fn cosine_falls_from_one_to_zero_and_constant_stays() {
        assert_eq!(rate_factor(ScheduleShape::Cosine, 0.0), 1.0);
        assert!((rate_factor(ScheduleShape::Cosine, 0.5) - 0.5).abs() < 1e-12);
        assert!(rate_factor(ScheduleShape::Cosine, 1.0).abs() < 1e-12);
        assert_eq!(rate_factor(ScheduleShape::Constant, 0.9), 1.0);
    }
}
