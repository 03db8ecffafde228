//! Station 6b for `w4a8`: one float row → nibbles whose lower bits are their neighbours' nibbles, with group scales.
//!
//! real output = row scale · input scale · (Σ over groups of (Σ w·q · group scale) / 2^16 + bias), with w the 16-bit
//! number of a column: its own nibble on top, below it the nibbles that lie below in the 32-bit word. So the device
//! multiplies words as they lie in flash, and the quantiser compensates here for what its neighbours add.
//!
//! Why here: rounding from the lowest nibble upwards knows the lower bits of every number, so that each ends within
//! half a nibble of the wanted weight, as plain 4-bit rounding does.
//! Source: the raw-word packing of `../shared/notes/embedded.md`, section 2, at 4 bits.

use karakuri::kernel::GROUP_TILES;
use karakuri::packing::{BLOCK_ROWS, nibble_shift};

use crate::quantize::layer::InputScale;

/// Columns that share a scale.
pub const GROUP_COLUMNS: usize = OCTET * GROUP_TILES;
/// Columns are padded to a multiple of this; padding columns hold the zero point, a real input of 0.
pub const COLUMN_MULTIPLE: usize = 16;
/// Columns of one 32-bit word.
const OCTET: usize = 8;
/// Column of the octet whose nibble lies at bits 4·p..4·p+4 of its word. // (p)
const COLUMN_AT: [usize; OCTET] = {
    let mut columns = [0; OCTET];
    let mut column = 0;
    while column < OCTET {
        columns[nibble_shift(column) as usize / 4] = column;
        column += 1;
    }
    columns
};
/// 16-bit numbers per nibble step.
const NIBBLE_ONE: f64 = 4096.0;
/// Largest group scale.
const SCALE_MAX: f64 = 32_767.0;
/// Units that the search tries for each group, as shares of the one at which nothing is clamped.
const CANDIDATES: [f64; 12] = [0.56, 0.6, 0.64, 0.68, 0.72, 0.76, 0.8, 0.84, 0.88, 0.92, 0.96, 1.0];
/// Largest magnitude of a stored input for which no group's sum can overflow: 64 · 32768 · 1023 < 2^31.
const INPUT_MAX: i64 = 1023;

/// One row of `w4a8`.
#[derive(Clone, Debug, PartialEq)]
pub struct NibbleRow {
    /// 16-bit number of each column, padding included; its nibble is its top four bits. // (column)
    pub numbers: Vec<i16>,
    /// Q0.16 factor from group sum to accumulator, at most 32767. // (group)
    pub group_scales: Vec<u16>,
    /// Accumulator units; the zero point of the input is folded in.
    pub bias: i32,
    /// Real value, per real unit of input, of an accumulator's 1 at an input of 1.
    pub scale: f64,
    /// Largest accumulator that any input can cause; below 2^31. The certificate.
    pub accumulator_max: i64,
}

impl NibbleRow {
    /// Own nibbles, −8..=7. // (column)
    pub fn nibbles(&self) -> impl Iterator<Item = i8> + '_ {
        self.numbers.iter().map(|number| (number >> 12) as i8)
    }

    /// The real weights that the device multiplies by, padding included. // (column)
    pub fn effective_weights(&self) -> impl Iterator<Item = f64> + '_ {
        let groups = self.numbers.chunks(GROUP_COLUMNS).zip(&self.group_scales);
        groups.flat_map(move |(numbers, &group_scale)| {
            let unit = f64::from(group_scale) / 65_536.0 * self.scale;
            numbers.iter().map(move |&number| f64::from(number) * unit)
        })
    }

    /// 32-bit words. // (octet)
    pub fn words(&self) -> impl Iterator<Item = u32> + '_ {
        self.numbers.chunks_exact(OCTET).map(|octet| {
            let nibble = |(place, &column): (usize, &usize)| {
                u32::from(octet[column].cast_unsigned() >> 12) << (4 * place)
            };
            COLUMN_AT.iter().enumerate().map(nibble).sum()
        })
    }
}

/// Rounds one row at the finest scale whose certificate holds.
///
/// The certificate is Σ over groups of (Σ|w|·max|q|·group scale / 2^16 + 1) + |bias| < 2^31; a group's own sum cannot
/// overflow. `input_mean` (may be empty) corrects the bias for the rounding of the weights.
///
/// # Accuracy
/// Of 2^16 weights that the chosen unit does not clamp, none is more than half a unit off, RMS at most 0.30 units
/// (asserted by `unclamped_weight_is_within_half_a_nibble`).
///
/// # Panics
/// If `input.magnitude_max` is above 1023: a group's sum could overflow.
pub fn quantize_nibble_row(
    weights: &[f32],
    bias: f64,
    input: InputScale,
    input_mean: &[f32],
) -> NibbleRow {
    assert!(input.magnitude_max <= INPUT_MAX, "nibbles need inputs of at most {INPUT_MAX}");
    let mut wanted: Vec<f64> = weights.iter().map(|&weight| f64::from(weight)).collect();
    wanted.resize(weights.len().next_multiple_of(COLUMN_MULTIPLE), 0.0);
    let units: Vec<f64> = wanted.chunks(GROUP_COLUMNS).map(best_unit).collect();
    let largest = units.iter().copied().fold(0.0, f64::max);
    // An all-zero row still needs a scale at which its bias fits.
    let mut scale = (largest * 16.0 / SCALE_MAX)
        .max(bias.abs() / (input.scale * 2f64.powi(30)))
        .max(f64::MIN_POSITIVE * 1e20);
    loop {
        let row = Row { wanted: &wanted, units: &units, input, input_mean };
        if let Some(row) = row.quantize_at(bias, scale) {
            return row;
        }
        scale *= 1.02;
    }
}

struct Row<'a> {
    /// // (column, padded)
    wanted: &'a [f64],
    /// Real value of a nibble's 1. // (group)
    units: &'a [f64],
    input: InputScale,
    input_mean: &'a [f32],
}

impl Row<'_> {
    fn quantize_at(&self, bias: f64, scale: f64) -> Option<NibbleRow> {
        let group_scale = |unit: &f64| (unit * 16.0 / scale).round().clamp(0.0, SCALE_MAX) as u16;
        let group_scales: Vec<u16> = self.units.iter().map(group_scale).collect();
        let groups = self.wanted.chunks(GROUP_COLUMNS).zip(&group_scales);
        let numbers = groups
            .flat_map(|(group, &stored)| round_group(group, f64::from(stored) / 16.0 * scale));
        let numbers = numbers.collect();
        let mut row = NibbleRow { numbers, group_scales, bias: 0, scale, accumulator_max: 0 };
        let correction = self.lost_at_mean_input(&row);
        let real_bias = ((bias + correction) / (scale * self.input.scale)).round();
        let sum: f64 = row.effective_weights().sum::<f64>() / scale;
        let stored_bias = real_bias - (f64::from(self.input.zero_point) * sum).round();
        row.accumulator_max = row.weighted_max(self.input.magnitude_max) + stored_bias.abs() as i64;
        row.bias = stored_bias as i32;
        let fits = real_bias.abs() < 2f64.powi(31) && row.accumulator_max <= i64::from(i32::MAX);
        fits.then_some(row)
    }

    /// What the rounding of the weights takes from the output at the mean input, in real units.
    fn lost_at_mean_input(&self, row: &NibbleRow) -> f64 {
        let lost = self.wanted.iter().zip(row.effective_weights()).zip(self.input_mean);
        lost.map(|((wanted, stored), &mean)| (wanted - stored) * f64::from(mean)).sum()
    }
}

impl NibbleRow {
    /// Largest magnitude of the sum over all groups, rounding included.
    fn weighted_max(&self, input_max: i64) -> i64 {
        let groups = self.numbers.chunks(GROUP_COLUMNS).zip(&self.group_scales);
        let group_max = |(numbers, &group_scale): (&[i16], &u16)| {
            let magnitude: i64 =
                numbers.iter().map(|number| i64::from(number.unsigned_abs())).sum();
            ((magnitude * input_max * i64::from(group_scale)) >> 16) + 1
        };
        groups.map(group_max).sum()
    }
}

/// The unit (real value of a nibble's 1) at which a group loses least, in squares; 0 for a group of zeros.
///
/// Tries [`CANDIDATES`], then the least-squares unit for the numbers that won.
fn best_unit(wanted: &[f64]) -> f64 {
    let largest = wanted.iter().fold(0.0f64, |largest, weight| largest.max(weight.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    let scored = |unit: f64| (squared_error(wanted, unit), unit);
    let less = |a: (f64, f64), b: (f64, f64)| if b.0 < a.0 { b } else { a };
    let best = CANDIDATES.iter().map(|share| scored(share * largest / 7.0));
    let best = best.fold((f64::INFINITY, 0.0), less);
    less(best, scored(least_squares_unit(wanted, best.1))).1
}

/// The unit nearest to `wanted` for the numbers that `unit` rounds to.
fn least_squares_unit(wanted: &[f64], unit: f64) -> f64 {
    let (mut products, mut squares) = (0.0, f64::MIN_POSITIVE);
    for (weight, number) in wanted.iter().zip(round_group(wanted, unit)) {
        let number = f64::from(number) / NIBBLE_ONE;
        products += weight * number;
        squares += number * number;
    }
    products / squares
}

/// Sum of squares of what rounding at `unit` loses.
fn squared_error(wanted: &[f64], unit: f64) -> f64 {
    let stored = round_group(wanted, unit).map(|number| f64::from(number) / NIBBLE_ONE * unit);
    wanted.iter().zip(stored).map(|(wanted, stored)| (wanted - stored).powi(2)).sum()
}

/// 16-bit numbers of a run of octets, in units of `unit` / 4096.
fn round_group(wanted: &[f64], unit: f64) -> impl Iterator<Item = i16> + '_ {
    let reciprocal = if unit > 0.0 { 1.0 / unit } else { 0.0 };
    wanted.chunks_exact(OCTET).flat_map(move |octet| round_octet(octet, reciprocal))
}

/// From the lowest nibble upwards: each number's lower twelve bits are the three nibbles below, already chosen.
fn round_octet(wanted: &[f64], reciprocal: f64) -> [i16; OCTET] {
    let mut numbers = [0; OCTET];
    let mut below = 0i32;
    for column in COLUMN_AT {
        let nibble = wanted[column] * reciprocal - f64::from(below) / NIBBLE_ONE;
        // Nearest, ties up: the cast truncates a number that is not negative.
        let nibble = (nibble.clamp(-8.0, 7.0) + 8.5) as i32 - 8;
        let number = (nibble << 12) | below;
        numbers[column] = number as i16;
        below = (number >> 4) & 0xFFF;
    }
    numbers
}

/// Weights and scales of a layer as the blob stores them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PackedNibbles {
    /// Little-endian 32-bit words. // (block, octet, row of the block)
    pub words: Vec<u8>,
    /// Little-endian u16. // (block, group, row of the block)
    pub group_scales: Vec<u8>,
}

/// Packs rows of equal width, padded with rows of zeros to a multiple of 4.
///
/// Octets of a group follow each other, so (block, group, octet of the group, row) is (block, octet, row).
pub fn pack_nibbles(rows: &[NibbleRow]) -> PackedNibbles {
    let mut packed = PackedNibbles::default();
    for block in rows.chunks(BLOCK_ROWS) {
        let words: Vec<Vec<u32>> = block.iter().map(|row| row.words().collect()).collect();
        for octet in 0..words[0].len() {
            let word = |row| words.get(row).map_or(0, |words: &Vec<u32>| words[octet]);
            packed.words.extend((0..BLOCK_ROWS).flat_map(|row| word(row).to_le_bytes()));
        }
        for group in 0..block[0].group_scales.len() {
            let scale = |row| block.get(row).map_or(0, |row: &NibbleRow| row.group_scales[group]);
            packed.group_scales.extend((0..BLOCK_ROWS).flat_map(|row| scale(row).to_le_bytes()));
        }
    }
    packed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const INPUT: InputScale = InputScale { scale: 0.01, zero_point: -31, magnitude_max: 127 };

    /// What the device multiplies by: the brief of the format, read from the packed word alone.
    fn numbers_of_word(word: u32) -> [i16; OCTET] {
        let low = |word: u32| word as i16;
        let high = |word: u32| (word >> 16) as i16;
        let [w0, w4, w8, w12] = [0, 4, 8, 12].map(|shift| word << shift);
        [low(w0), low(w4), high(w0), high(w4), low(w8), low(w12), high(w8), high(w12)]
    }

    /// `sum += (group sum · group scale) >> 16` for every group, as the kernel does.
    fn accumulate(row: &NibbleRow, input: &[i16]) -> i64 {
        let words: Vec<u32> = row.words().collect();
        let numbers: Vec<i16> = words.into_iter().flat_map(numbers_of_word).collect();
        let groups = numbers.chunks(GROUP_COLUMNS).zip(input.chunks(GROUP_COLUMNS));
        let sum = |((numbers, input), &scale): ((&[i16], &[i16]), &u16)| {
            let products = numbers.iter().zip(input).map(|(&w, &x)| i32::from(w) * i32::from(x));
            (products.map(i64::from).sum::<i64>() * i64::from(scale)) >> 16
        };
        groups.zip(&row.group_scales).map(sum).sum::<i64>() + i64::from(row.bias)
    }

    #[test]
    #[should_panic(expected = "inputs of at most 1023")]
    fn input_of_sixteen_bits_is_refused() {
        quantize_nibble_row(&[1.0], 0.0, InputScale { magnitude_max: 1 << 15, ..INPUT }, &[]);
    }

    #[test]
    fn all_zero_row_keeps_its_bias() {
        let row = quantize_nibble_row(&[0.0; 20], -1.25, INPUT, &[]);
        assert_eq!((row.numbers.len(), row.group_scales.as_slice()), (32, &[0][..]));
        let real = f64::from(row.bias) * row.scale * INPUT.scale;
        assert!((real + 1.25).abs() < 1e-6, "{real}");
    }

    #[test]
    fn row_that_would_overflow_gets_a_coarser_scale() {
        let row = quantize_nibble_row(&[1.0; 4096], 0.0, INPUT, &[]);
        assert!(row.accumulator_max <= i64::from(i32::MAX));
        assert!(row.group_scales[0] < 32_767);
    }

    #[test]
    fn unclamped_weight_is_within_half_a_nibble() {
        let mut random = 1u64;
        let mut draw = || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (random >> 40) as f64 / 2f64.powi(24) * 14.0 - 7.0
        };
        let wanted: Vec<f64> = (0..1 << 16).map(|_| draw()).collect();
        let errors = wanted.iter().zip(round_group(&wanted, 1.0));
        let errors = errors.map(|(wanted, number)| wanted - f64::from(number) / NIBBLE_ONE);
        let (worst, sum) = errors.fold((0.0f64, 0.0), |(worst, sum), error| {
            (worst.max(error.abs()), sum + error * error)
        });
        assert!(worst <= 0.5, "max {worst} nibbles");
        let rms = (sum / 65_536.0).sqrt();
        assert!(rms <= 0.30, "RMS {rms} nibbles");
    }

    #[test]
    fn packed_words_stand_by_block_octet_and_row() {
        let row = |value: f32| quantize_nibble_row(&[value; 72], 0.0, INPUT, &[]);
        let rows: Vec<NibbleRow> = (1..=5).map(|value| row(value as f32)).collect();
        let packed = pack_nibbles(&rows);
        assert_eq!(packed.words.len(), 2 * 10 * 4 * 4);
        assert_eq!(packed.group_scales.len(), 2 * 2 * 4 * 2);
        let word = |block: usize, octet: usize, row: usize| {
            let first = ((block * 10 + octet) * 4 + row) * 4;
            u32::from_le_bytes(packed.words[first..first + 4].try_into().unwrap())
        };
        assert_eq!(word(0, 3, 2), rows[2].words().nth(3).unwrap());
        assert_eq!(word(1, 9, 0), rows[4].words().nth(9).unwrap());
        assert_eq!(word(1, 9, 1), 0);
        let scale = rows[3].group_scales[1].to_le_bytes();
        assert_eq!(packed.group_scales[(4 + 3) * 2..(4 + 3) * 2 + 2], scale);
    }

    proptest! {
        #[test]
        fn words_hold_the_very_numbers_of_the_row(weights in prop::collection::vec(-3.0f32..3.0, 1..200)) {
            let row = quantize_nibble_row(&weights, 0.5, INPUT, &[]);
            let numbers: Vec<i16> = row.words().flat_map(numbers_of_word).collect();
            prop_assert_eq!(&numbers, &row.numbers);
            let own: Vec<i8> = numbers.iter().map(|number| (number >> 12) as i8).collect();
            prop_assert_eq!(own, row.nibbles().collect::<Vec<_>>());
        }

        #[test]
        fn no_input_exceeds_the_certificate(
            weights in prop::collection::vec(-3.0f32..3.0, 1..300), bias in -100.0f32..100.0,
            zero_point in -127i16..=127, signs: bool
        ) {
            let input = InputScale { zero_point, ..INPUT };
            let row = quantize_nibble_row(&weights, f64::from(bias), input, &[]);
            let worst: Vec<i16> =
                row.numbers.iter().map(|&w| if (w > 0) == signs { 127 } else { -127 }).collect();
            prop_assert!(accumulate(&row, &worst).abs() <= row.accumulator_max);
            prop_assert!(row.accumulator_max <= i64::from(i32::MAX));
        }

        #[test]
        fn accumulator_is_the_effective_weights_at_the_real_input(
            weights in prop::collection::vec(-3.0f32..3.0, 1..300), bias in -10.0f32..10.0,
            seed in 0i32..1000
        ) {
            let row = quantize_nibble_row(&weights, f64::from(bias), INPUT, &[]);
            let mut stored: Vec<i16> =
                (0..weights.len() as i32).map(|i| ((i * 37 + seed) % 255 - 127) as i16).collect();
            stored.resize(row.numbers.len(), INPUT.zero_point);
            let got = accumulate(&row, &stored) as f64 * row.scale * INPUT.scale;
            let real = |q: i16| f64::from(q - INPUT.zero_point) * INPUT.scale;
            let products = row.effective_weights().zip(&stored);
            let expected = products.map(|(w, &q)| w * real(q)).sum::<f64>() + f64::from(bias);
            // One floor a group and two roundings of the bias.
            let unit = row.scale * INPUT.scale;
            prop_assert!((got - expected).abs() <= unit * (row.group_scales.len() as f64 + 2.0));
        }

        #[test]
        fn rounding_loses_less_than_a_sixth_of_a_gaussian_row(seed in 0u64..200) {
            let mut state = seed;
            let mut uniform = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((state >> 33) as f32 + 0.5) / 2f32.powi(31)
            };
            let weights: Vec<f32> =
                (0..500).map(|_| (0..12).map(|_| uniform()).sum::<f32>() - 6.0).collect();
            let row = quantize_nibble_row(&weights, 0.0, INPUT, &[]);
            let lost = weights.iter().zip(row.effective_weights());
            let lost: f64 = lost.map(|(&w, stored)| (f64::from(w) - stored).powi(2)).sum();
            let whole: f64 = weights.iter().map(|&w| f64::from(w).powi(2)).sum();
            prop_assert!((lost / whole).sqrt() < 1.0 / 6.0, "{}", (lost / whole).sqrt());
        }
    }
}
