//! Where one servo should be between two aims.
//!
//! In:  one goal a tick.
//! Out: a goal every 5 ms, to `servo.rs`.
//!
//! Why here: a straight line from aim to aim bends at every tick, and a bend is an acceleration: at 50 ticks a second
//! four times that of the motion itself, which the limiter would have to refuse. A cubic with the motion's own velocity
//! at its ends has none.
//! Source: Fritsch & Carlson 1980: a cubic whose end slopes are between 0 and three times its rise never turns back.

/// Fraction bits of the weights.
const WEIGHT_BITS: u32 = 15;
const ONE: i32 = 1 << WEIGHT_BITS;

/// What the goals of one step are made of: the same for every servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PathWeights {
    /// Of the rise.
    rise: i32,
    /// Of what the slope at the start is more than the rise.
    start: i32,
    /// The same at the end.
    end: i32,
}

impl PathWeights {
    /// `since_us` after the start of a tick of `elapsed_us` (both at most 131 ms). After its end the path goes on
    /// straight, at most as far as the tick was long.
    pub fn at(since_us: u32, elapsed_us: u32) -> Self {
        let time = ((since_us << WEIGHT_BITS) / elapsed_us.max(1)).min(2 << WEIGHT_BITS) as i32;
        let left = ONE - time;
        if left <= 0 {
            return Self { rise: time, start: 0, end: left };
        }
        let both = (time * left) >> WEIGHT_BITS;
        Self { rise: time, start: (both * left) >> WEIGHT_BITS, end: (both * time) >> WEIGHT_BITS }
    }
}

/// The goals of one servo, Q16 µs.
#[derive(Clone, Debug)]
pub(crate) struct GoalPath {
    from: i32,
    to: i32,
    /// Rise of the last tick.
    rise_last: i32,
    /// Slope at the start of this tick, in rises.
    slope: i32,
}

impl GoalPath {
    /// Standing.
    pub fn new(at: i32) -> Self {
        Self { from: at, to: at, rise_last: 0, slope: 0 }
    }

    /// The goal at the end of this tick, at least 0.
    pub fn aim(&mut self, to: i32) {
        self.to = to;
    }

    /// Between the last two aims; after the end of the tick possibly beyond.
    pub fn at(&self, weights: PathWeights) -> i64 {
        let rise = i64::from(self.rise());
        let start = i64::from(within(self.slope, self.rise())) - rise;
        let end = i64::from(self.slope_at_end()) - rise;
        let sum = rise * i64::from(weights.rise) + start * i64::from(weights.start)
            - end * i64::from(weights.end);
        i64::from(self.from) + (sum >> WEIGHT_BITS)
    }

    /// The tick is over.
    pub fn pass(&mut self) {
        self.slope = self.slope_at_end();
        self.rise_last = self.rise();
        self.from = self.to;
    }

    fn rise(&self) -> i32 {
        self.to - self.from
    }

    /// As if the acceleration went on.
    fn slope_at_end(&self) -> i32 {
        let rise = self.rise();
        within(rise.saturating_add(rise / 2 - self.rise_last / 2), rise)
    }
}

/// The slope nearest to `slope` that never turns back.
fn within(slope: i32, rise: i32) -> i32 {
    let steepest = rise.saturating_mul(3);
    slope.max(steepest.min(0)).min(steepest.max(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn goal(path: &GoalPath, since_us: u32, elapsed_us: u32) -> i64 {
        path.at(PathWeights::at(since_us, elapsed_us))
    }

    #[test]
    fn steady_motion_is_a_line_and_goes_on_as_one() {
        let mut path = GoalPath::new(0);
        for tick in 1..5 {
            path.aim(tick << 20);
            path.pass();
        }
        path.aim(5 << 20);
        for since_us in [0, 5_000, 10_000, 20_000, 25_000] {
            assert_eq!(
                goal(&path, since_us, 20_000),
                (4 << 20) + i64::from(since_us) * (1 << 20) / 20_000
            );
        }
    }

    #[test]
    fn aim_that_stands_is_kept() {
        let mut path = GoalPath::new(7 << 20);
        path.aim(9 << 20);
        path.pass();
        path.aim(9 << 20);
        for since_us in [0, 1, 7_000, 20_000, 30_000, 100_000] {
            assert_eq!(goal(&path, since_us, 20_000), 9 << 20);
        }
    }

    /// 300 µs at 1 Hz, aimed at 50 times a second: at most 11,844 µs/s², four times that along straight lines.
    #[test]
    fn smooth_motion_has_no_bends() {
        let at = |time_s: f64| 1500.0 + 300.0 * libm::sin(time_s * core::f64::consts::TAU);
        let mut path = GoalPath::new((at(0.0) * 65_536.0) as i32);
        let mut goals_us = std::vec::Vec::new();
        for tick in 1..=100 {
            path.aim((at(f64::from(tick) * 0.02) * 65_536.0) as i32);
            (1..=4).for_each(|step| {
                goals_us.push(goal(&path, step * 5_000, 20_000) as f64 / 65_536.0)
            });
            path.pass();
        }
        let error_us =
            |(step, goal_us): (usize, &f64)| (goal_us - at((step + 1) as f64 * 0.005)).abs();
        let error_us = goals_us.iter().enumerate().skip(8).map(error_us).fold(0.0, f64::max);
        let bend = |window: &[f64]| (window[2] - 2.0 * window[1] + window[0]).abs() / 25e-6;
        let bend_max = goals_us.windows(3).skip(8).map(bend).fold(0.0, f64::max);
        assert!(error_us < 0.6 && bend_max < 30_000.0, "{error_us} us, {bend_max} us/s2");
    }

    proptest! {
        #[test]
        fn path_stays_between_its_aims_and_ends_at_the_last(
            aims in prop::collection::vec(0..=20_000i32 << 16, 2..20), elapsed_us in 1..100_000u32,
            part in 0..=1000u32
        ) {
            let mut path = GoalPath::new(aims[0]);
            for pair in aims.windows(2) {
                path.aim(pair[1]);
                let since_us = elapsed_us * part / 1000;
                let found = goal(&path, since_us, elapsed_us);
                // A weight is off by up to 2^-15 of three rises.
                let slack = i64::from(pair[0].abs_diff(pair[1])) / 8192 + 1;
                let (low, high) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
                prop_assert!((i64::from(low) - slack..=i64::from(high) + slack).contains(&found));
                prop_assert_eq!(goal(&path, elapsed_us, elapsed_us), i64::from(pair[1]));
                path.pass();
            }
        }
    }
}
