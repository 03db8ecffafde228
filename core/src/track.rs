//! The curve through decoded poses: what the body does between two frames.
//!
//! In:  the poses at two keys before and two keys after now, and how far between the middle two now is.
//! Out: a channel's value and its slope.
//!
//! Why here: a pose costs a hundred times what a point between poses does, so a decoder runs at 12 to 50 poses a
//! second and the servos at 50 to 200. Straight lines would give the servos a kink at every key; Catmull-Rom
//! splines keep the velocity continuous, pass through every decoded pose and need one pose of foresight, which a
//! decoder that can decode any frame has.
//! Source: Catmull and Rom, 1974, "A class of local interpolating splines"; uniform, tension 1/2.

/// 1 in Q0.16.
pub(crate) const ONE_Q16: i32 = 1 << 16;

/// Channel values at four keys, Q15.16. // (key, channel)
#[derive(Clone, Debug)]
pub(crate) struct Track<const CHANNELS: usize> {
    keys: [[i32; CHANNELS]; 4],
}

/// Factors on the four keys, Q16; those of a value add up to 1, those of a slope to 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct KeyWeights([i32; 4]);

impl KeyWeights {
    /// Of the value at `place` (Q0.16, 0..=1) between the second and the third key.
    pub fn value(place_q16: u32) -> Self {
        let (once, squared, cubed) = powers(place_q16);
        let before = halved(2 * squared - cubed - once);
        let after = halved(4 * squared - 3 * cubed + once);
        let last = halved(cubed - squared);
        Self([before, ONE_Q16 - before - after - last, after, last])
    }

    /// Of the slope there, in channel units per distance of keys.
    pub fn slope(place_q16: u32) -> Self {
        let (once, squared, _) = powers(place_q16);
        let before = halved(4 * once - 3 * squared - ONE_Q16);
        let after = halved(8 * once - 9 * squared + ONE_Q16);
        let last = halved(3 * squared - 2 * once);
        Self([before, -before - after - last, after, last])
    }
}

fn powers(place_q16: u32) -> (i32, i32, i32) {
    let place = i64::from(place_q16.min(1 << 16));
    let (squared, cubed) = ((place * place) >> 16, (place * place * place) >> 32);
    (place as i32, squared as i32, cubed as i32)
}

const fn halved(twice: i32) -> i32 {
    (twice + 1) >> 1
}

impl<const CHANNELS: usize> Track<CHANNELS> {
    /// All keys alike: a body that stands still. Channels that `pose` does not have are 0.
    pub fn still(pose: &[i32]) -> Self {
        let mut track = Self { keys: [[0; CHANNELS]; 4] };
        track.stand(pose);
        track
    }

    /// Makes all keys alike.
    pub fn stand(&mut self, pose: &[i32]) {
        for key in &mut self.keys {
            copy(key, pose);
        }
    }

    /// Takes the next key in and lets the first go.
    pub fn push(&mut self, pose: &[i32]) {
        self.keys.rotate_left(1);
        let [.., last] = &mut self.keys;
        copy(last, pose);
    }

    /// Takes in a key as far beyond the last one as that is beyond the one before: where a motion ends.
    pub fn push_beyond(&mut self) {
        let [_, _, before, last] = &self.keys;
        let mut beyond = [0; CHANNELS];
        for (beyond, (before, last)) in beyond.iter_mut().zip(before.iter().zip(last)) {
            *beyond = last.saturating_add(last.saturating_sub(*before));
        }
        self.push(&beyond);
    }

    /// Puts a pose in the place of key `KEY` (0 to 3).
    pub fn put<const KEY: usize>(&mut self, pose: &[i32]) {
        const { assert!(KEY < 4) };
        if let Some(key) = self.keys.get_mut(KEY) {
            copy(key, pose);
        }
    }

    /// Makes the first key as far before the second as that is before the third, as where a motion begins; where it
    /// also ends, the last key as far beyond the third as that is beyond the second.
    pub fn fill_ends(&mut self, ends: bool) {
        let [first, second, third, last] = &mut self.keys;
        let middle = second.iter().zip(&*third);
        for ((first, last), (second, third)) in first.iter_mut().zip(last).zip(middle) {
            *first = second.saturating_sub(third.saturating_sub(*second));
            if ends {
                *last = third.saturating_add(third.saturating_sub(*second));
            }
        }
    }

    /// Every channel's weighted sum: nearest, ties up; saturated.
    ///
    /// # Accuracy
    /// Against the exact spline within 1.2 · 2^-16 of the largest of the four keys, 0.5 · 2^-16 RMS (asserted by
    /// `spline_stays_near_the_exact_one`).
    pub fn weighted(&self, weights: KeyWeights) -> impl Iterator<Item = i32> {
        let [a, b, c, d] = &self.keys;
        let KeyWeights(weights) = weights;
        let keys = a.iter().zip(b).zip(c.iter().zip(d));
        keys.map(move |((&a, &b), (&c, &d))| {
            let products = [a, b, c, d].into_iter().zip(weights);
            let sum: i64 = products.map(|(key, weight)| i64::from(key) * i64::from(weight)).sum();
            saturate((sum + (1 << 15)) >> 16)
        })
    }
}

pub(crate) fn saturate(value: i64) -> i32 {
    value.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

fn copy(key: &mut [i32], pose: &[i32]) {
    for (channel, &value) in key.iter_mut().zip(pose) {
        *channel = value;
    }
}

#[cfg(test)]
mod tests {
    use super::{KeyWeights, ONE_Q16, Track};
    use crate::deviation::Deviation;
    use proptest::prelude::*;

    fn track(keys: [i32; 4]) -> Track<1> {
        let mut track = Track::still(&[keys[0]]);
        for key in &keys[1..] {
            track.push(&[*key]);
        }
        track
    }

    fn value(track: &Track<1>, place_q16: u32) -> i32 {
        track.weighted(KeyWeights::value(place_q16)).next().unwrap()
    }

    fn slope(track: &Track<1>, place_q16: u32) -> i32 {
        track.weighted(KeyWeights::slope(place_q16)).next().unwrap()
    }

    #[test]
    fn spline_stays_near_the_exact_one() {
        let mut errors = Deviation::default();
        let keys = [-90.0, 45.0, 80.0, -20.0].map(|key| key * 65_536.0);
        let track = track(keys.map(|key| key as i32));
        for place in 0..=65_536u32 {
            let u = f64::from(place) / 65_536.0;
            let [a, b, c, d] = keys;
            let exact = 0.5
                * (2.0 * b
                    + (c - a) * u
                    + (2.0 * a - 5.0 * b + 4.0 * c - d) * u * u
                    + (3.0 * b - a - 3.0 * c + d) * u * u * u);
            errors.add(f64::from(value(&track, place)) - exact);
        }
        // In units of the last place, of keys of up to 90 · 2^16.
        errors.assert_at_most(1.2 * 90.0, 0.5 * 90.0);
    }

    proptest! {
        #[test]
        fn body_that_stands_still_has_exactly_its_pose(pose in any::<i32>(), place in 0..=65_536u32) {
            let track = track([pose; 4]);
            prop_assert_eq!(value(&track, place), pose);
            prop_assert_eq!(slope(&track, place), 0);
        }

        #[test]
        fn position_and_velocity_are_continuous_over_a_key(
            keys in prop::collection::vec(-200 * ONE_Q16..200 * ONE_Q16, 5)
        ) {
            let [a, b, c, d, e] = keys[..] else { unreachable!() };
            let (before, after) = (track([a, b, c, d]), track([b, c, d, e]));
            prop_assert_eq!(value(&before, 1 << 16), c);
            prop_assert_eq!(value(&after, 0), c);
            prop_assert!((slope(&before, 1 << 16) - slope(&after, 0)).abs() <= 1);
        }

        #[test]
        fn extreme_keys_saturate(keys in any::<[i32; 4]>(), place in 0..=65_536u32) {
            value(&track(keys), place);
            slope(&track(keys), place);
            let mut ends = track(keys);
            ends.push_beyond();
            ends.fill_ends(true);
        }
    }
}
