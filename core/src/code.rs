//! Station 8: what makes one motion differ from another.

use crate::limits::CODE_MAX;

/// A sequence code β followed by an action code α, in the model's code format
/// (i16 with `Model::code_fraction_bits` fraction bits).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Code {
    pub(crate) values: heapless::Vec<i16, CODE_MAX>,
}

impl Code {
    /// A code without numbers, to be filled by [`Model::sample_into`](crate::Model::sample_into).
    pub const fn new() -> Self {
        Self { values: heapless::Vec::new() }
    }

    /// The numbers, β then α.
    pub fn values(&self) -> &[i16] {
        &self.values
    }

    /// Adds numbers at the end. The loader has checked that all numbers of a model's codes fit; more would be dropped.
    pub(crate) fn append(&mut self, numbers: impl Iterator<Item = i16>) {
        for number in numbers {
            let _ = self.values.push(number);
        }
    }

    /// Moves this code towards `other` by `fraction` (Q0.16: 65,536 is all the way), per number, rounded to nearest.
    ///
    /// Interpolating codes interpolates motions and actions (ODMO, section 4.3). Codes of different models do not mix.
    pub fn move_towards(&mut self, other: &Self, fraction: u32) {
        let fraction = i64::from(fraction.min(1 << 16));
        for (value, &target) in self.values.iter_mut().zip(&other.values) {
            *value = interpolate(*value, target, fraction);
        }
    }
}

/// `from + (to − from) · fraction / 2^16`, rounded to nearest; `fraction` in 0..=2^16, so the result lies between.
pub(crate) fn interpolate(from: i16, to: i16, fraction: i64) -> i16 {
    let step = (i64::from(i32::from(to) - i32::from(from)) * fraction + (1 << 15)) >> 16;
    (i64::from(from) + step) as i16
}

#[cfg(test)]
mod tests {
    use super::interpolate;

    #[test]
    fn interpolation_reaches_both_ends_without_overflow() {
        for (from, to) in [(i16::MIN, i16::MAX), (i16::MAX, i16::MIN), (-3, 5)] {
            assert_eq!(interpolate(from, to, 0), from);
            assert_eq!(interpolate(from, to, 1 << 16), to);
        }
        assert_eq!(interpolate(i16::MIN, i16::MAX, 1 << 15), 0);
    }
}
