//! How the body gets from what it did to what it does next: the difference at the switch dies away.
//!
//! In:  position and velocity of the difference between the old and the new motion at the switch.
//! Out: what to add to the new motion for a while.
//!
//! Why here: a cross-fade would have to decode two motions at once, and one that is interrupted three. Here only the
//! new motion is decoded; the old one lives on as two numbers a channel, whatever made them, so a switch may come
//! at any tick, in the midst of another. Position and velocity are continuous, and the difference ends without speed
//! or acceleration.
//! Source: Bollo, GDC 2018, "Inertialization"; quintic with the boundary conditions of minimum jerk (Flash and
//! Hogan, 1985).

use crate::track::{ONE_Q16, saturate};

/// A difference that dies away. // (channel)
#[derive(Clone, Debug)]
pub(crate) struct Inertia<const CHANNELS: usize> {
    /// At the switch, Q15.16.
    offset: [i32; CHANNELS],
    /// Its velocity there, per duration, Q15.16.
    drift: [i32; CHANNELS],
    age_us: u32,
    duration_us: u32,
}

/// Factors on offset and drift, Q16.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fading {
    offset: i32,
    drift: i32,
}

impl Fading {
    /// Of the difference: 1 − 10u³ + 15u⁴ − 6u⁵ and u − 6u³ + 8u⁴ − 3u⁵ at u = `place` (Q0.16, 0..=1).
    ///
    /// # Accuracy
    /// 2.1 · 2^-16 max, 1.0 · 2^-16 RMS (asserted by `fading_follows_the_quintics`).
    pub fn value(place_q16: u32) -> Self {
        let place = i64::from(place_q16.min(1 << 16));
        let cubed_q32 = (place * place * place) >> 16;
        let whole = horner(place, [6, -15, 10]);
        let drift = horner(place, [3, -8, 6]);
        Self {
            offset: ONE_Q16 - ((cubed_q32 * whole) >> 32) as i32,
            drift: (place - ((cubed_q32 * drift) >> 32)) as i32,
        }
    }

    /// Of its velocity per duration: −30u² + 60u³ − 30u⁴ and 1 − 18u² + 32u³ − 15u⁴; as accurate.
    pub fn slope(place_q16: u32) -> Self {
        let place = i64::from(place_q16.min(1 << 16));
        let squared_q32 = place * place;
        let whole = horner(place, [30, -60, 30]);
        let drift = horner(place, [15, -32, 18]);
        Self {
            offset: -((squared_q32 * whole) >> 32) as i32,
            drift: ONE_Q16 - ((squared_q32 * drift) >> 32) as i32,
        }
    }
}

/// `a·u² + b·u + c` in Q16.
fn horner(place_q16: i64, [a, b, c]: [i64; 3]) -> i64 {
    let once = a * place_q16 + (b << 16);
    ((once * place_q16) >> 16) + (c << 16)
}

impl<const CHANNELS: usize> Inertia<CHANNELS> {
    /// No difference.
    pub const fn none() -> Self {
        Self { offset: [0; CHANNELS], drift: [0; CHANNELS], age_us: 0, duration_us: 0 }
    }

    /// Begins to fade `offset` and `drift` (per `duration_us`) of every channel.
    pub fn begin(&mut self, duration_us: u32, differences: impl Iterator<Item = (i32, i32)>) {
        let places = self.offset.iter_mut().zip(&mut self.drift);
        for ((offset, drift), difference) in places.zip(differences) {
            (*offset, *drift) = difference;
        }
        (self.age_us, self.duration_us) = (0, duration_us);
    }

    /// Lets time pass.
    pub fn advance(&mut self, elapsed_us: u32) {
        self.age_us = self.age_us.saturating_add(elapsed_us).min(self.duration_us);
    }

    /// What is left of the fading, µs.
    pub fn remaining_us(&self) -> u32 {
        self.duration_us - self.age_us
    }

    /// The whole of the fading, µs; 0 when there is none.
    pub fn duration_us(&self) -> u32 {
        self.duration_us
    }

    /// Where the fading is, Q0.16; `None` once it is over.
    pub fn place_q16(&self) -> Option<u32> {
        if self.age_us >= self.duration_us {
            return None;
        }
        Some(((u64::from(self.age_us) << 16) / u64::from(self.duration_us)) as u32)
    }

    /// Every channel's difference, or its velocity per duration: rounded down, saturated.
    pub fn weighted(&self, fading: Fading) -> impl Iterator<Item = i32> {
        self.offset.iter().zip(&self.drift).map(move |(&offset, &drift)| {
            let offset = i64::from(offset) * i64::from(fading.offset);
            saturate((offset + i64::from(drift) * i64::from(fading.drift)) >> 16)
        })
    }
}

/// Numbers that go where they are told without a jump or a kink.
#[derive(Clone, Debug)]
pub(crate) struct Glide<const COUNT: usize> {
    goals: [i32; COUNT],
    inertia: Inertia<COUNT>,
}

impl<const COUNT: usize> Glide<COUNT> {
    /// Numbers that stand.
    pub const fn at(goals: [i32; COUNT]) -> Self {
        Self { goals, inertia: Inertia::none() }
    }

    /// Sends the numbers to `goals`, there after `duration_us`; from wherever they are and however they move.
    pub fn go(&mut self, goals: [i32; COUNT], duration_us: u32) {
        let duration_us = duration_us.max(1);
        let (values, slopes) = (self.values(), self.slopes(duration_us));
        self.goals = goals;
        let offsets = values.iter().zip(goals).map(|(value, goal)| value.saturating_sub(goal));
        self.inertia.begin(duration_us, offsets.zip(slopes));
    }

    /// Lets time pass.
    pub fn advance(&mut self, elapsed_us: u32) {
        self.inertia.advance(elapsed_us);
    }

    /// The numbers now.
    pub fn values(&self) -> [i32; COUNT] {
        let mut values = self.goals;
        if let Some(place_q16) = self.inertia.place_q16() {
            let differences = self.inertia.weighted(Fading::value(place_q16));
            for (value, difference) in values.iter_mut().zip(differences) {
                *value = value.saturating_add(difference);
            }
        }
        values
    }

    fn slopes(&self, duration_us: u32) -> [i32; COUNT] {
        let mut slopes = [0; COUNT];
        if let Some(place_q16) = self.inertia.place_q16() {
            let share_q16 = (i64::from(duration_us) << 16) / i64::from(self.inertia.duration_us());
            let velocities = self.inertia.weighted(Fading::slope(place_q16));
            for (slope, velocity) in slopes.iter_mut().zip(velocities) {
                *slope = saturate(i64::from(velocity).saturating_mul(share_q16) >> 16);
            }
        }
        slopes
    }
}

#[cfg(test)]
mod tests {
    use super::{Fading, Glide, Inertia};
    use crate::deviation::Deviation;

    #[test]
    fn fading_follows_the_quintics() {
        let mut errors = Deviation::default();
        let mut slope_errors = Deviation::default();
        for place in 0..=65_536u32 {
            let u = f64::from(place) / 65_536.0;
            let fading = Fading::value(place);
            let exact = 1.0 - u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
            errors.add(f64::from(fading.offset) - exact * 65_536.0);
            let exact = u - u.powi(3) * (6.0 - 8.0 * u + 3.0 * u * u);
            errors.add(f64::from(fading.drift) - exact * 65_536.0);
            let slope = Fading::slope(place);
            let exact = -30.0 * u * u * (1.0 - 2.0 * u + u * u);
            slope_errors.add(f64::from(slope.offset) - exact * 65_536.0);
            let exact = 1.0 - u * u * (18.0 - 32.0 * u + 15.0 * u * u);
            slope_errors.add(f64::from(slope.drift) - exact * 65_536.0);
        }
        errors.assert_at_most(2.1, 1.0);
        slope_errors.assert_at_most(2.1, 0.8);
    }

    #[test]
    fn difference_begins_as_it_was_and_ends_at_nothing() {
        let mut inertia = Inertia::<1>::none();
        assert_eq!(inertia.place_q16(), None);
        inertia.begin(500_000, [(77_000, -30_000)].into_iter());
        let at = |inertia: &Inertia<1>| {
            let place = inertia.place_q16().unwrap();
            let value = inertia.weighted(Fading::value(place)).next().unwrap();
            (value, inertia.weighted(Fading::slope(place)).next().unwrap())
        };
        assert_eq!(at(&inertia), (77_000, -30_000));
        inertia.advance(499_999);
        let (value, slope) = at(&inertia);
        assert!(value.abs() <= 4 && slope.abs() <= 20, "{value}, {slope}");
        inertia.advance(u32::MAX);
        assert_eq!((inertia.place_q16(), inertia.remaining_us()), (None, 0));
    }

    #[test]
    fn stop_without_acceleration_never_turns_back() {
        // Half a drift ahead: the terms of the fifth degree cancel and 1 − 3u² + 2u³ is what is left of the velocity.
        let mut inertia = Inertia::<1>::none();
        inertia.begin(1000, [(-50_000, 100_000)].into_iter());
        let mut last = -50_001;
        while let Some(place) = inertia.place_q16() {
            let value = inertia.weighted(Fading::value(place)).next().unwrap();
            assert!(value >= last - 3 && value <= 3, "{last}, {value}");
            last = value;
            inertia.advance(1);
        }
    }

    #[test]
    fn number_that_is_sent_elsewhere_on_its_way_neither_jumps_nor_turns_sharply() {
        let mut glide = Glide::at([0]);
        let mut course = std::vec::Vec::new();
        for step in 0..2000u32 {
            if step % 130 == 0 {
                let goal = if step % 260 == 0 { 1 << 16 } else { -(1 << 16) };
                glide.go([goal], 500_000);
            }
            course.push(glide.values()[0]);
            glide.advance(1000);
        }
        let speeds: std::vec::Vec<i32> = course.windows(2).map(|pair| pair[1] - pair[0]).collect();
        // Two units in half a second at the most: 3.75 units a second, about 60 units a second squared on the way.
        assert!(speeds.iter().all(|speed| speed.abs() < 400), "{:?}", speeds.iter().max());
        let turns = speeds.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        assert!(turns.clone().max() < Some(8), "{:?}", turns.max());
        glide.advance(u32::MAX);
        assert_eq!(glide.values(), [-(1 << 16)]);
    }
}
