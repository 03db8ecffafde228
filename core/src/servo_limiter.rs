//! One servo's motion in whole numbers, in steps of 5 ms: never out of range, never too fast, never too hard.
//!
//! In:  limits of one servo; at every step, where it should be.
//! Out: where it is told to be, to `servo.rs`.
//!
//! Why here: this is the file that keeps the machine whole, so it does nothing else. Positions are Q16 µs, velocities
//! Q16 µs a step, accelerations Q16 µs a step².
//!
//! **Why it cannot leave the range.** Let A be the largest change of velocity, x⁺ = max(x, 0), and
//! `S(v) = v + (v−A)⁺ + (v−2A)⁺ + …` the way of a servo that does one step at v and then brakes. Every step keeps the
//! promise `S(v−A) ≤ max − p`: braking from now on ends inside. A step may take v' if
//! * `v' ≤ v − A`: then `S(v') ≤ S(v−A) ≤ max − p`; or
//! * `v' ≤ brake(max − p)`, where `S(brake(d)) ≤ d`: with v = nA + f, `S(v) = v²/2A + v/2 + f(A−f)/2A`, the last term
//!   is at most A/8, and `v²/2A + v/2 + A/8 ≤ d` is `v ≤ (√(8Ad) − A) / 2`; and `S(v) = v` up to A.
//!
//! Either way `p' = p + v' ≤ max` and `S(v'−A) ≤ S(v') − v' ≤ max − p'`, which is the promise again (v' < 0 cannot
//! break it). The lower end is the mirror image. A velocity that both ends and all limits allow always exists, because
//! 0 lies between `−brake` and `brake`, and v between `v−A` and `v+A`.

use crate::servo_map::{ServoMap, pulse_q16};

/// A step, µs: 200 Hz, the fastest loop of common servos.
pub(crate) const STEP_US: u32 = 5_000;

/// Largest velocity and acceleration: 8192 µs a step, which crosses a hobby servo's range at once. Sums fit 32 bits.
const STEP_MAX_Q16: u64 = 1 << 29;

/// What kept a servo from being where it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Intervention {
    None,
    Speed,
    /// Or the brakes before an end of the range, or those towards the goal.
    Acceleration,
}

/// The motion of one servo.
#[derive(Clone, Debug)]
pub(crate) struct ServoLimiter {
    min_us: u16,
    max_us: u16,
    velocity_max: i32,
    acceleration_max: i32,
    /// From this distance on no brake is needed.
    brake_length: i32,
    position: i32,
    velocity: i32,
}

impl ServoLimiter {
    /// Standing at the park pulse. Limits are rounded down.
    pub fn new(map: &ServoMap) -> Self {
        let limits = map.limits();
        // µs/s · 5·10^-3 · 2^16, and µs/s² · (5·10^-3)² · 2^16.
        let velocity = u64::from(limits.pulse_us_per_s_max) * 8192 / 25;
        let acceleration = u64::from(limits.pulse_us_per_s2_max) * 1024 / 625;
        let velocity = velocity.clamp(1, STEP_MAX_Q16);
        let acceleration = acceleration.clamp(1, STEP_MAX_Q16);
        let brake_length =
            velocity * velocity / (2 * acceleration) + velocity / 2 + acceleration / 8 + 3;
        let [min_us, _, max_us] = map.pulses_us();
        Self {
            min_us,
            max_us,
            velocity_max: velocity as i32,
            acceleration_max: acceleration as i32,
            brake_length: brake_length.min(i32::MAX as u64) as i32,
            position: pulse_q16(map.pulse_us_park()),
            velocity: 0,
        }
    }

    pub fn position(&self) -> i32 {
        self.position
    }

    pub fn is_standing(&self) -> bool {
        self.velocity == 0
    }

    /// Where it is `ahead_us` before its last step: on the line between the last two, at most a step back.
    pub fn position_before(&self, ahead_us: u32) -> i32 {
        // Shares in 2^-32, so that even the fastest servo is where it should be to 2^-16 µs.
        const SHARE_OF_US: u64 = (1 << 48) / STEP_US as u64;
        let share = (u64::from(ahead_us.min(STEP_US)) * SHARE_OF_US) >> 16;
        let back = (i64::from(self.velocity) * share as i64) >> 32;
        self.position - back as i32
    }

    /// Stands at `position`, which must be in range: where the servo is known to be, whatever it was doing.
    pub fn stand_at(&mut self, position: i32) {
        self.position = position;
        self.velocity = 0;
    }

    /// One step as close to `goal` as the limits allow; `goal_last` was the goal of the step before.
    ///
    /// The goal's own velocity is taken over and the way that is missing is caught up with as fast as it can still be
    /// braked. So a goal that moves within the limits is followed exactly, and one that stands is reached exactly,
    /// without overshoot from rest.
    pub fn follow(&mut self, goal_last: i32, goal: i32) -> Intervention {
        let moving = (goal - goal_last).max(-self.velocity_max).min(self.velocity_max);
        let missing = goal_last - self.position;
        let catching_up = self.brake(missing.abs()) * missing.signum();
        self.advance(moving + catching_up);
        // What a pulse of whole microseconds cannot show is no intervention.
        if (goal - self.position).abs() < 1 << 16 {
            Intervention::None
        } else if self.velocity.abs() == self.velocity_max {
            Intervention::Speed
        } else {
            Intervention::Acceleration
        }
    }

    /// One step of braking, or of standing.
    pub fn hold(&mut self) {
        self.advance(0);
    }

    /// One step at the velocity that is nearest to `wish` among those that the proof above allows.
    fn advance(&mut self, wish: i32) {
        let (min, max) = (pulse_q16(self.min_us), pulse_q16(self.max_us));
        let slower = self.velocity - self.acceleration_max;
        let faster = self.velocity + self.acceleration_max;
        let upper = slower.max(self.brake(max - self.position)).min(faster).min(self.velocity_max);
        let lower =
            faster.min(-self.brake(self.position - min)).max(slower).max(-self.velocity_max);
        let velocity = wish.max(lower).min(upper);
        debug_assert!(velocity.abs_diff(self.velocity) <= self.acceleration_max as u32);
        debug_assert!(velocity.abs() <= self.velocity_max);
        self.velocity = velocity;
        self.position += velocity;
        debug_assert!((min..=max).contains(&self.position));
    }

    /// A velocity from which a servo comes to rest within `distance`, this step included; nearly the largest.
    fn brake(&self, distance: i32) -> i32 {
        if distance <= self.acceleration_max {
            return distance;
        }
        if distance >= self.brake_length {
            return self.velocity_max;
        }
        // Below 2^3 · 2^29 · 2^31.
        let root = root_down(8 * self.acceleration_max as u64 * distance as u64);
        let twice = root - i64::from(self.acceleration_max);
        ((twice / 2) as i32).max(self.acceleration_max)
    }
}

/// The square root, rounded down to 16 significant bits: a division of 64 bits is long on small cores.
fn root_down(square: u64) -> i64 {
    let shift = (32u32.saturating_sub(square.leading_zeros()) + 1) & !1;
    i64::from(((square >> shift) as u32).isqrt()) << (shift / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;
    use crate::servo_map::ServoLimits;

    impl ServoLimiter {
        /// For tests of what contains it: velocity, and the largest change of it in a step.
        pub fn velocity_and_change_max(&self) -> (i32, i32) {
            (self.velocity, self.acceleration_max)
        }
    }

    fn limiter(speed: u32, acceleration: u32) -> ServoLimiter {
        let limits = ServoLimits { pulse_us_per_s_max: speed, pulse_us_per_s2_max: acceleration };
        ServoLimiter::new(&ServoMap::new(0, [500, 1500, 2500], 1 << 16, limits).unwrap())
    }

    /// Limits from hardly moving to crossing the range at once.
    fn any_limiter(random: &mut Pcg32) -> ServoLimiter {
        loop {
            let speed = random.next_u32() >> (random.next_u32() % 32);
            let acceleration = random.next_u32() >> (random.next_u32() % 32);
            let limits =
                ServoLimits { pulse_us_per_s_max: speed, pulse_us_per_s2_max: acceleration };
            let mut pulses_us = [(); 3].map(|()| 1 + (random.next_u32() % 20_000) as u16);
            pulses_us.sort_unstable();
            if let Ok(map) = ServoMap::new(0, pulses_us, 1, limits) {
                return ServoLimiter::new(&map);
            }
        }
    }

    #[test]
    fn root_is_never_too_large_and_hardly_too_small() {
        let mut random = Pcg32::new(1);
        for _ in 0..100_000 {
            let word = u64::from(random.next_u32()) << 32 | u64::from(random.next_u32());
            let square = word >> (1 + random.next_u32() % 63);
            let (root, exact) = (root_down(square), square.isqrt() as i64);
            assert!(root <= exact && exact - root <= 1 + exact / 32_768, "{square}");
        }
        assert_eq!([0, 1, 4, 80, u64::from(u32::MAX)].map(root_down), [0, 1, 2, 8, 65_535]);
    }

    #[test]
    fn velocity_that_the_brakes_allow_stops_within_the_distance() {
        let mut random = Pcg32::new(2);
        for _ in 0..20_000 {
            let limiter = any_limiter(&mut random);
            let distance = (random.next_u32() >> (1 + random.next_u32() % 31)) as i32;
            let velocity = i64::from(limiter.brake(distance).min(limiter.velocity_max));
            let change = i64::from(limiter.acceleration_max);
            let whole = velocity / change;
            let way = (whole + 1) * velocity - change * whole * (whole + 1) / 2;
            assert!(way <= i64::from(distance), "{limiter:?} {distance}");
        }
    }

    /// 6,000,000 steps after whatever goals there are; those of a random walk, at the ends, anywhere.
    #[test]
    fn no_step_leaves_range_speed_or_acceleration() {
        let mut random = Pcg32::new(3);
        for _ in 0..3000 {
            let mut limiter = any_limiter(&mut random);
            let (min, max) = (pulse_q16(limiter.min_us), pulse_q16(limiter.max_us));
            let (mut goal, mut goal_last) = (limiter.position, limiter.position);
            for _ in 0..2000 {
                let word = random.next_u32();
                goal = match word % 8 {
                    0 => min,
                    1 => max,
                    2 => min + ((u64::from(word) * (max - min) as u64) >> 32) as i32,
                    3..6 => (goal + (word as i32 >> 12)).max(min).min(max),
                    _ => goal,
                };
                let velocity_last = limiter.velocity;
                if word % 64 == 63 {
                    limiter.hold();
                } else {
                    limiter.follow(goal_last, goal);
                }
                goal_last = goal;
                assert!((min..=max).contains(&limiter.position));
                assert!(limiter.velocity.abs() <= limiter.velocity_max);
                assert!(
                    limiter.velocity.abs_diff(velocity_last) as i32 <= limiter.acceleration_max
                );
            }
        }
    }

    #[test]
    fn servo_on_its_way_stops_when_held_and_stays() {
        let mut limiter = limiter(6000, 60_000);
        let (start, end) = (limiter.position, pulse_q16(2500));
        (0..30).for_each(|_| _ = limiter.follow(end, end));
        // 6000 µs/s for 0.1 s of braking: 300 µs, and half a step.
        let at = limiter.position;
        (0..21).for_each(|_| limiter.hold());
        assert!(limiter.is_standing() && at > start + pulse_q16(500));
        assert!((pulse_q16(280)..pulse_q16(301)).contains(&(limiter.position - at)));
    }

    #[test]
    fn goal_that_stands_is_reached_exactly_without_overshoot() {
        let mut random = Pcg32::new(4);
        for _ in 0..2000 {
            let speed = 100 + random.next_u32() % 20_000;
            let slowest = speed * speed / 4000 + 1;
            let mut limiter = limiter(speed, slowest + random.next_u32() % 1_000_000);
            let goal = pulse_q16(500) + (random.next_u32() % (2000 << 16)) as i32;
            let side = (goal - limiter.position).signum();
            let mut steps = 0;
            while limiter.position != goal || !limiter.is_standing() {
                limiter.follow(goal, goal);
                steps += 1;
                assert!((goal - limiter.position).signum() * side >= 0, "overshoot");
                assert!(steps < 10_000);
            }
        }
    }

    #[test]
    fn goal_that_moves_within_the_limits_is_followed_exactly() {
        let mut limiter = limiter(6000, 60_000);
        let mut goal_last = limiter.position;
        for step in 1..2000 {
            // 400 µs at 1 Hz: 2513 µs/s and 15,791 µs/s² at most.
            let radians = f64::from(step) * 0.005 * core::f64::consts::TAU;
            let goal = pulse_q16(1500) + (400.0 * 65_536.0 * (1.0 - libm::cos(radians))) as i32;
            assert_eq!(limiter.follow(goal_last, goal), Intervention::None);
            assert_eq!(limiter.position, goal);
            goal_last = goal;
        }
    }
}
