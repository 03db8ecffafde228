//! How far a drawn code lies from the average of its action.
//!
//! In:  a code as it was drawn; the dials of intensity and variety.
//! Out: the code, stretched about the mean of its action's components.
//!
//! Why here: the mean stands nowhere in a blob. It is worked out when it is needed, once a motion.

use super::{Sampler, saturate};
use crate::code::Code;
use crate::model::ActionId;
use crate::variety::Variety;

/// Columns whose means are worked out in one reading of all rows.
const MEAN_COLUMNS: usize = 16;

impl Sampler<'_> {
    /// Stretches a code about the mean of its action's components by Q4.12, every number a little differently where
    /// variety says so; rounded to nearest, saturated.
    #[inline(never)]
    pub(super) fn move_from_mean(
        &self,
        action: ActionId,
        intensity_q12: u16,
        variety: Variety,
        random: &mut impl FnMut() -> u32,
        code: &mut Code,
    ) {
        let intensity = i64::from(intensity_q12);
        for (place, values) in code.values.chunks_mut(MEAN_COLUMNS).enumerate() {
            let means = self.means_of(action, place * MEAN_COLUMNS);
            for (value, mean) in values.iter_mut().zip(means) {
                let factor_q24 = intensity * variety.stretch_q12(random);
                let out_q24 = (i64::from(*value) - mean) * factor_q24;
                *value = saturate(mean + ((out_q24 + (1 << 23)) >> 24));
            }
        }
    }

    /// Means of a few columns over the components of an action, rounded down; every component counts once in each of
    /// its intervals. A few at a time, because numbers of uneven length are found by reading the row from its start.
    fn means_of(&self, action: ActionId, column: usize) -> [i64; MEAN_COLUMNS] {
        let (mut sums, mut count) = ([0i64; MEAN_COLUMNS], 0);
        for interval in self.intervals().filter(|interval| interval.action == action.0) {
            for member in 0..interval.member_count {
                let numbers = self.mean(self.component_of(&interval, member)).skip(column);
                for (sum, number) in sums.iter_mut().zip(numbers) {
                    *sum += i64::from(number);
                }
                count += 1;
            }
        }
        sums.map(|sum| sum.div_euclid(count.max(1)))
    }
}
