//! How many bits each number of a clip's code is worth, and how it is rounded to them.
//!
//! In:  rows of numbers, the noise that every column gets anyway, and how many bits a row may have.
//! Out: [`Column`]s, to `nearest_clips` and `quantize`.
//!
//! Why here: the decoder has learned to ignore differences below a code's own σ, so a small share of it costs nothing.
//! Bits go where an error is largest in units of that σ, one after another (Cover and Thomas, "Elements of Information
//! Theory", 10.3.3: reverse water-filling). Rotating the codes to their principal axes first would save 3 % of the
//! bytes at 32 numbers a code and half of them at 128 (HumanAct12, prototype), for a rotation in flash;
//! it is not built.

/// Most bits of a number.
const BITS_MAX: u8 = 8;
/// Errors below this share of σ are not worth a bit.
const ERROR_MIN: f64 = 0.1;
/// Ends of the stored range that are tried, as shares of the way from the mean to the outermost value.
const REACHES: [f64; 8] = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3];

/// One column of a table: 2^bits evenly spaced values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Value of 0.
    pub least: f64,
    /// Distance of neighbouring values.
    pub step: f64,
    /// At most 8; with none every number is `least`.
    pub bits: u8,
}

impl Column {
    /// The stored number nearest to `value`.
    pub fn encode(&self, value: f64) -> u8 {
        let largest = f64::from((1u16 << self.bits) - 1);
        ((value - self.least) / self.step).round().clamp(0.0, largest) as u8
    }

    /// What a stored number stands for.
    pub fn decode(&self, number: u8) -> f64 {
        self.least + f64::from(number) * self.step
    }

    /// `value` as it is stored.
    pub fn round(&self, value: f64) -> f64 {
        self.decode(self.encode(value))
    }

    fn square_error(&self, values: &[f64]) -> f64 {
        let errors = values.iter().map(|value| (self.round(*value) - value).powi(2));
        errors.sum::<f64>() / values.len().max(1) as f64
    }

    /// The range with the least square error; the outermost values may be cut.
    fn fit(values: &[f64], bits: u8) -> Self {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let least = values.iter().copied().fold(mean, f64::min);
        let largest = values.iter().copied().fold(mean, f64::max);
        if bits == 0 {
            return Self { least: mean, step: 1.0, bits };
        }
        let candidate = |below: f64, above: f64| {
            let (low, high) = (mean + below * (least - mean), mean + above * (largest - mean));
            let step = ((high - low) / f64::from((1u16 << bits) - 1)).max(1e-9);
            Self { least: low, step, bits }
        };
        let mut best = candidate(1.0, 1.0);
        let mut error = best.square_error(values);
        for (below, above) in REACHES.iter().flat_map(|&b| REACHES.map(|a| (b, a))) {
            let column = candidate(below, above);
            let found = column.square_error(values);
            if found < error {
                (best, error) = (column, found);
            }
        }
        best
    }
}

/// Columns of a table at `bits_mean` bits a number or fewer, and the mean square error of each.
///
/// # Shapes
/// `rows` (row)(column) · `deviations` (column): σ of the noise that is added to a drawn number
pub fn fit_columns(rows: &[Vec<f64>], deviations: &[f64], bits_mean: f64) -> Vec<(Column, f64)> {
    let choices: Vec<Vec<(Column, f64)>> =
        (0..deviations.len()).map(|index| choices_of_column(rows, index)).collect();
    let mut bits = vec![0_usize; deviations.len()];
    let loss = |column: usize, bits: usize| {
        choices[column][bits].1 / (deviations[column] * deviations[column]).max(1e-12)
    };
    let all = (bits_mean.clamp(0.0, f64::from(BITS_MAX)) * deviations.len() as f64) as usize;
    for _ in 0..all {
        let open = (0..bits.len()).filter(|&column| {
            bits[column] < usize::from(BITS_MAX)
                && loss(column, bits[column]) > ERROR_MIN * ERROR_MIN
        });
        let Some(worst) = open.max_by(|&a, &b| loss(a, bits[a]).total_cmp(&loss(b, bits[b])))
        else {
            break;
        };
        bits[worst] += 1;
    }
    choices.iter().zip(bits).map(|(choices, bits)| choices[bits]).collect()
}

/// The best column of every number of bits, with its mean square error. // (bits)
fn choices_of_column(rows: &[Vec<f64>], index: usize) -> Vec<(Column, f64)> {
    let values: Vec<f64> = rows.iter().map(|row| row[index]).collect();
    let choice = |bits| {
        let column = Column::fit(&values, bits);
        (column, column.square_error(&values))
    };
    (0..=BITS_MAX).map(choice).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two columns: one spreads over ±1, the other hardly at all.
    fn rows() -> Vec<Vec<f64>> {
        (0..101).map(|i| f64::from(i - 50) / 50.0).map(|x| vec![x, 0.001 * x]).collect()
    }

    #[test]
    fn column_below_its_noise_gets_no_bits() {
        let columns = fit_columns(&rows(), &[0.05, 0.05], 8.0);
        assert_eq!(columns[1].0.bits, 0);
        assert!((4..8).contains(&columns[0].0.bits), "{}", columns[0].0.bits);
        assert!(columns[0].1.sqrt() < 0.1 * 0.05);
    }

    #[test]
    fn bits_are_never_more_than_allowed() {
        for bits_mean in [0.0, 0.5, 2.0, 7.0, 99.0] {
            let columns = fit_columns(&rows(), &[1e-6, 1e-6], bits_mean);
            let bits: u32 = columns.iter().map(|(column, _)| u32::from(column.bits)).sum();
            assert!(f64::from(bits) <= 2.0 * bits_mean.min(8.0), "{bits} of {bits_mean}");
        }
    }

    #[test]
    fn every_stored_number_survives_rounding() {
        for bits in 0..=8 {
            let column = Column { least: -0.7, step: 0.013, bits };
            for number in 0..1_u16 << bits {
                let number = number as u8;
                assert_eq!(column.encode(column.decode(number)), number);
            }
            assert_eq!(column.encode(f64::MAX), ((1_u16 << bits) - 1) as u8);
            assert_eq!(column.encode(f64::MIN), 0);
        }
    }

    #[test]
    fn values_far_out_are_cut_where_that_helps_the_others() {
        let mut values: Vec<f64> = (0..1000).map(|i| f64::from(i % 100) / 100.0).collect();
        values.push(3.0);
        let column = Column::fit(&values, 3);
        assert!(column.decode(7) < 1.5, "{column:?}");
    }
}
