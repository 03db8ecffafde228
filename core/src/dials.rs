//! How a character does what it is told; turned at any time, by a sensor, a knob or a script.
//!
//! Why here: users ask for less, slower and calmer motion as often as for more, and never for another model. All four
//! are arguments of what is computed anyway, so a dial at its middle costs nothing.

/// Four dials in Q4.12: 4096 is 1, which is what the model was trained to do. [`Dials::clamped`] says how far each
/// turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dials {
    /// Distance of a motion's code from the mean of its action: 0 is always the same average motion, 2 is twice as
    /// far out as learned. Taken up by the next motion. 0..=2.
    pub intensity_q12: u16,
    /// Speed of time. Taken up at once, within half a second. 1/4..=4.
    pub rate_q12: u16,
    /// Share of the time that an idle body rests between two motions; 1: it does not move at all. 0..=1.
    pub stillness_q12: u16,
    /// Temperature of the draw: 0 is always the clip nearest in length, below 1 fewer clips and less noise, above 1
    /// more of both, larger steps between clips, and a little more or less of every number of the code. Taken up by
    /// the next motion. 0..=2.
    pub variety_q12: u16,
}

impl Dials {
    /// 1 of any dial.
    pub const ONE_Q12: u16 = 1 << 12;

    /// As trained; an idle body rests two thirds of the time.
    pub const NEUTRAL: Self = Self {
        intensity_q12: Self::ONE_Q12,
        rate_q12: Self::ONE_Q12,
        stillness_q12: 2731,
        variety_q12: Self::ONE_Q12,
    };

    /// Each dial at the nearest value that it has.
    pub fn clamped(self) -> Self {
        Self {
            intensity_q12: self.intensity_q12.min(2 * Self::ONE_Q12),
            rate_q12: self.rate_q12.clamp(Self::ONE_Q12 / 4, 4 * Self::ONE_Q12),
            stillness_q12: self.stillness_q12.min(Self::ONE_Q12),
            variety_q12: self.variety_q12.min(2 * Self::ONE_Q12),
        }
    }
}

impl Default for Dials {
    fn default() -> Self {
        Self::NEUTRAL
    }
}

#[cfg(test)]
mod tests {
    use super::Dials;

    #[test]
    fn dial_beyond_its_end_stands_at_its_end() {
        let all = |value| Dials {
            intensity_q12: value,
            rate_q12: value,
            stillness_q12: value,
            variety_q12: value,
        };
        let Dials { intensity_q12, rate_q12, stillness_q12, variety_q12 } = all(u16::MAX).clamped();
        assert_eq!(
            [intensity_q12, rate_q12, stillness_q12, variety_q12],
            [8192, 16_384, 4096, 8192]
        );
        assert_eq!(all(0).clamped(), Dials { rate_q12: 1024, ..all(0) });
        assert_eq!(Dials::NEUTRAL.clamped(), Dials::NEUTRAL);
    }
}
