//! From standing still to following: which share of the way to the target counts, step by step.
//!
//! In:  steps of the servo stage.
//! Out: a share from 0 to 1 to `servo.rs`.
//!
//! Why here: a servo that stands may be far from what is aimed at, and however hard its limits allow it to start, a
//! body that wakes should not.
//! Source: Flash & Hogan 1985: 10t³ − 15t⁴ + 6t⁵ is the way of least jerk from rest to rest.

/// Fraction bits of shares: fine enough that their steps are no acceleration.
const BITS: u32 = 24;
const ONE: u64 = 1 << BITS;

/// How far a soft start has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SoftStart {
    step: u16,
    step_count: u16,
    waits: bool,
}

impl SoftStart {
    /// 2 s: half the range of a common servo, 1000 µs, at 940 µs/s at most.
    pub const FROM_PARK_STEPS: u16 = 400;
    /// 1 s.
    pub const FROM_STANDING_STEPS: u16 = 200;

    pub const fn done() -> Self {
        Self { step: 0, step_count: 0, waits: false }
    }

    pub const fn from_park() -> Self {
        Self { step: 0, step_count: Self::FROM_PARK_STEPS, waits: false }
    }

    /// To begin when all servos stand.
    pub const fn from_standing() -> Self {
        Self { step: 0, step_count: Self::FROM_STANDING_STEPS, waits: true }
    }

    pub const fn waits_for_standing(self) -> bool {
        self.waits
    }

    /// The share of the next step.
    pub fn step(&mut self) -> Share {
        self.waits = false;
        if self.step >= self.step_count {
            return Share(ONE);
        }
        self.step += 1;
        let time = (u32::from(self.step) << 16) / u32::from(self.step_count);
        let time = u64::from(time) << (BITS - 16);
        let square = (time * time) >> BITS;
        let cube = (square * time) >> BITS;
        Share((cube * (10 * ONE + 6 * square - 15 * time)) >> BITS)
    }
}

/// 0 to 1, Q24.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Share(u64);

impl Share {
    /// This share of the way, rounded down; all of it exactly.
    pub fn between(self, from: i32, to: i32) -> i32 {
        if self.0 >= ONE {
            return to;
        }
        let way = i64::from(to) - i64::from(from);
        from + ((way * self.0 as i64) >> BITS) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_rises_from_nothing_to_everything_and_never_falls() {
        for mut start in [SoftStart::from_park(), SoftStart::from_standing()] {
            let mut last = 0;
            for _ in 0..start.step_count {
                let time = f64::from(start.step + 1) / f64::from(start.step_count);
                let share = start.step().0;
                let exact = time.powi(3) * (10.0 + time * (6.0 * time - 15.0));
                assert!((share as f64 / ONE as f64 - exact).abs() < 3e-5, "{time}");
                assert!(share >= last);
                last = share;
            }
            assert_eq!((last, start.step().0), (ONE, ONE));
        }
    }

    #[test]
    fn way_of_every_share_is_between_its_ends() {
        for share in [0, 1, ONE / 3, ONE - 1, ONE].map(Share) {
            for (from, to) in [(0, i32::MAX), (i32::MAX, 0), (5, 5)] {
                assert!((from.min(to)..=from.max(to)).contains(&share.between(from, to)));
            }
        }
    }
}
