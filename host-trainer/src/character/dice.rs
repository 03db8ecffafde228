//! The only source of chance in the character.
//!
//! In:  seed, action label, clip index.
//! Out: numbers to `actor.rs`.
//!
//! Why here: a clip must have the same bits on every machine and in every later release, so the
//! stream of a clip depends on nothing but these three, and floats are made from its words by exact
//! arithmetic of our own.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Longest label that the dice can tell from all others.
pub const LABEL_BYTES_MAX: usize = 16;

/// Draws of one clip.
#[derive(Clone, Debug)]
pub struct Dice(ChaCha8Rng);

impl Dice {
    /// The stream of one clip. Other clips, actions and seeds have unrelated streams.
    pub fn new(seed: u64, action: &str, clip_index: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&clip_index.to_le_bytes());
        for (slot, byte) in key[32 - LABEL_BYTES_MAX..].iter_mut().zip(action.bytes()) {
            *slot = byte;
        }
        Self(ChaCha8Rng::from_seed(key))
    }

    /// Uniform in [0, 1), a multiple of 2⁻⁵³: exact in f64.
    fn unit(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.0.next_u64() >> 11) as f64 * STEP
    }

    /// Uniform in [`low`, `high`).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Bell-shaped around 1 and never outside 1 ± `spread`: the mean of three uniform draws.
    pub fn about_one(&mut self, spread: f64) -> f64 {
        let mean = (self.unit() + self.unit() + self.unit()) / 3.0;
        1.0 + spread * (2.0 * mean - 1.0)
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Whole number in `low..=high`.
    pub fn count(&mut self, low: u32, high: u32) -> u32 {
        low + (self.unit() * f64::from(high - low + 1)) as u32
    }

    /// −1 or 1.
    pub fn side(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dice() -> Dice {
        Dice::new(1, "nod", 0)
    }

    #[test]
    fn every_draw_stays_in_its_range_and_reaches_both_halves() {
        let mut dice = dice();
        let draws = (0..1000).map(|_| dice.between(-2.0, 4.0)).collect::<Vec<_>>();
        assert!(draws.iter().all(|draw| (-2.0..4.0).contains(draw)));
        assert!((300..700).contains(&draws.iter().filter(|draw| **draw < 1.0).count()));
        assert!((0..1000).all(|_| (0.7..=1.3).contains(&dice.about_one(0.3))));
        let counts = (0..1000).map(|_| dice.count(2, 4)).collect::<Vec<_>>();
        for count in 2..=4 {
            assert!(counts.contains(&count));
        }
        assert!(counts.iter().all(|count| (2..=4).contains(count)));
    }

    #[test]
    fn seed_action_and_clip_each_change_the_stream() {
        let first = dice().between(0.0, 1.0);
        assert_eq!(dice().between(0.0, 1.0), first);
        for mut other in [Dice::new(2, "nod", 0), Dice::new(1, "bow", 0), Dice::new(1, "nod", 1)] {
            assert_ne!(other.between(0.0, 1.0), first);
        }
    }
}
