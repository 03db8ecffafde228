//! Which values a configuration may hold: one line a key.

use std::fmt::Display;
use std::path::Path;

use super::{CodeComposition, TrainConfig};
use crate::error::{Error, Result};

/// One key: its name, its value, whether the value is in order, and what is expected.
type Rule = (&'static str, String, bool, &'static str);

impl TrainConfig {
    /// Refuses values that no run could use.
    ///
    /// # Errors
    /// `BadInput` naming the first key whose value is out of range.
    pub fn check(&self, source: &Path) -> Result<()> {
        let rules = self.model_rules().into_iter().chain(self.training_rules());
        match rules.into_iter().find(|rule| !rule.2) {
            None => Ok(()),
            Some((key, value, _, expected)) => {
                Err(Error::bad_input(source, key, value, expected, "correct the value"))
            }
        }
    }

    fn model_rules(&self) -> [Rule; 8] {
        let (widths, time, codes) = (&self.decoder.hidden_widths, &self.time, &self.codes);
        let widths_fit = !widths.is_empty() && widths.iter().all(|w| (1..=65_535).contains(w));
        let sinusoids = time.sinusoid_count;
        [
            (
                "decoder.hidden_widths",
                format!("{widths:?}"),
                widths_fit,
                "one width or more, each 1 to 65535",
            ),
            (
                "time.sinusoid_count",
                sinusoids.to_string(),
                sinusoids >= 2 && sinusoids.is_multiple_of(2),
                "an even number of 2 or more",
            ),
            (
                "time.base",
                time.base.to_string(),
                time.base > 1.0 && time.base.is_finite(),
                "a number above 1",
            ),
            one_or_more("codes.sequence_dimensions", codes.sequence_dimensions),
            one_or_more("codes.action_dimensions", codes.action_dimensions),
            (
                "codes.log_variance_start",
                codes.log_variance_start.to_string(),
                codes.log_variance_start.abs() <= 20.0,
                "a number from -20 to 20",
            ),
            rule(
                "codes.action_dimensions",
                codes.action_dimensions,
                codes.compose != CodeComposition::Add
                    || codes.action_dimensions == codes.sequence_dimensions,
                "that of codes.sequence_dimensions, for codes that are added",
            ),
            rule(
                "codes.action_code",
                codes.action_code,
                codes.compose != CodeComposition::Add || codes.action_code,
                "true, for codes that are added",
            ),
        ]
    }

    fn training_rules(&self) -> [Rule; 12] {
        let (adam, budget) = (&self.adam, &self.budget);
        [
            share_below_one("hold_out", self.hold_out),
            zero_or_more("loss.kl_weight", self.loss.kl_weight),
            one_or_more("batch.clips", self.batch.clips),
            one_or_more("batch.frames", self.batch.frames),
            zero_or_more("update.gradient_norm_max", self.update.gradient_norm_max),
            learning_rate("adam.decoder_learning_rate", adam.decoder_learning_rate),
            learning_rate("adam.code_learning_rate", adam.code_learning_rate),
            share_below_one("adam.beta1", adam.beta1),
            share_below_one("adam.beta2", adam.beta2),
            ("adam.epsilon", adam.epsilon.to_string(), adam.epsilon > 0.0, "above 0"),
            (
                "budget.steps",
                budget.steps.to_string(),
                budget.steps >= 1 || budget.minutes > 0.0,
                "1 or more, unless `minutes` is above 0",
            ),
            zero_or_more("budget.minutes", budget.minutes),
        ]
    }
}

fn one_or_more(key: &'static str, value: usize) -> Rule {
    rule(key, value, value >= 1, "1 or more")
}

fn zero_or_more(key: &'static str, value: f64) -> Rule {
    rule(key, value, value >= 0.0 && value.is_finite(), "0 or more")
}

fn share_below_one(key: &'static str, value: f64) -> Rule {
    rule(key, value, (0.0..1.0).contains(&value), "0 or more, below 1")
}

fn learning_rate(key: &'static str, value: f64) -> Rule {
    rule(key, value, (0.0..=1.0).contains(&value), "a number from 0 to 1")
}

fn rule(key: &'static str, value: impl Display, holds: bool, expected: &'static str) -> Rule {
    (key, value.to_string(), holds, expected)
}
