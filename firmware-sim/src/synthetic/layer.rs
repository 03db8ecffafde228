//! One layer of a synthetic model: random weights, packed, and the scales that go with them.
//!
//! In:  shape and place of the layer in a manifest.
//! Out: bytes of its tensors.
//!
//! Why here: the only file of the benchmarks that knows what stored weights mean. Scales follow from the spread of the
//! weights, not from data as the quantiser's do.
//! Source: `core/src/packing.rs` for the order of weights; `host-trainer/src/quantize/` for the meaning of every scale.

use half::f16;
use karakuri::manifest::{CODE_LAYER, LayerShape, Manifest, Packing, TIME_LAYER, WeightFormat};
use karakuri::packing::{BLOCK_ROWS, ByteLayout, nibble_shift, nibble_weight};
use karakuri::{Pcg32, Requantizer};

use super::scale::{Scale, input_scale, takes_bytes, word_of};

/// Keeps the spread of pre-activations near 1 in spite of ELU, which narrows it.
const GAIN: f64 = 1.3;
/// Standard deviation of the biases.
const BIAS_DEVIATION: f64 = 0.1;
/// Standard deviation of stored 8-bit weights: they reach the end of their range at 3.3 of it.
const BYTE_DEVIATION: f64 = 127.0 / 3.3;
/// The same for 4-bit weights.
const NIBBLE_DEVIATION: f64 = 7.0 / 3.3;
/// Scale of every group of 4-bit weights, Q0.16: a quarter.
const GROUP_SCALE: u16 = 1 << 14;
/// Accumulators per 1 of an input and 1 of a 4-bit weight, which is 2^12 of a 16-bit number.
const NIBBLE_UNIT: f64 = 4096.0 * GROUP_SCALE as f64 / 65_536.0;

/// A layer before it is packed.
#[derive(Debug)]
pub struct Layer {
    shape: LayerShape,
    packing: Packing,
    /// Whether its inputs have 8 bits.
    bytes: bool,
    input: Scale,
    /// In units of the standard deviation of the layer's weights. // (out, in)
    weights: Vec<f64>,
    /// Real value of a weight of 1 standard deviation.
    deviation: f64,
    /// Real. // (out)
    biases: Vec<f64>,
}

impl Layer {
    /// Draws the weights of one layer of the manifest.
    pub fn draw(manifest: &Manifest<'_>, index: usize, random: &mut Pcg32) -> Self {
        let shape = manifest.layers[index];
        let (inputs, outputs) = (usize::from(shape.input_count), usize::from(shape.output_count));
        Self {
            shape,
            packing: manifest.packing,
            bytes: index != CODE_LAYER && takes_bytes(manifest.number_format),
            input: input_scale(index, shape.weights, manifest.number_format),
            weights: (0..inputs * outputs).map(|_| normal(random)).collect(),
            deviation: deviation(manifest, index),
            biases: (0..outputs).map(|_| normal(random) * BIAS_DEVIATION).collect(),
        }
    }

    /// Real value of an accumulator's 1.
    pub fn accumulator_scale(&self) -> f64 {
        let per_deviation = match self.shape.weights {
            WeightFormat::I4 => NIBBLE_DEVIATION * NIBBLE_UNIT,
            _ => BYTE_DEVIATION * self.product_unit(),
        };
        self.deviation * self.input.scale / per_deviation
    }

    /// Weights as they lie in the blob.
    pub fn weights(&self) -> Vec<u8> {
        match self.shape.weights {
            WeightFormat::I8 => {
                let mut packed = vec![0; self.shape.rows_filled() * self.shape.columns_filled()];
                let layout = ByteLayout::new(self.packing, self.bytes);
                layout.pack(&self.shape, &self.stored_bytes(), &mut packed);
                packed
            }
            WeightFormat::I4 => {
                let rows = self.nibble_rows();
                let octet = |index: usize| rows.iter().map(|row| row[index]).collect();
                by_blocks((0..self.shape.columns_filled() / 8).map(octet).collect())
                    .flat_map(u32::to_le_bytes)
                    .collect()
            }
            WeightFormat::Half => {
                let inputs = usize::from(self.shape.input_count);
                let filled = self.weights.chunks_exact(inputs).map(<[f64]>::to_vec);
                let filled = filled.chain(std::iter::repeat(vec![0.0; inputs]));
                let rows: Vec<_> = filled.take(self.shape.rows_filled()).collect();
                let column = |column| rows.iter().map(|row| row[column] * self.deviation).collect();
                by_blocks((0..inputs).map(column).collect())
                    .flat_map(|weight: f64| f16::from_f64(weight).to_le_bytes())
                    .collect()
            }
        }
    }

    /// Scales of the groups of 4-bit weights.
    pub fn group_scales(&self) -> Vec<u8> {
        let bytes = self.shape.rows_filled() / BLOCK_ROWS * self.shape.block_scale_bytes();
        GROUP_SCALE.to_le_bytes().repeat(bytes / 2)
    }

    /// Biases, with the zero point of the inputs folded in.
    pub fn biases(&self) -> Vec<u8> {
        let filled = self.shape.rows_filled();
        let real = self.biases.iter().copied().chain(std::iter::repeat(0.0)).take(filled);
        if self.shape.weights == WeightFormat::Half {
            return real.flat_map(|bias| (bias as f32).to_le_bytes()).collect();
        }
        let sums = self.row_sums().into_iter().chain(std::iter::repeat(0.0));
        let zero_point = f64::from(self.input.zero_point);
        real.zip(sums)
            .map(|(bias, sum)| bias / self.accumulator_scale() - zero_point * sum)
            .flat_map(|bias| (bias.round() as i32).to_le_bytes())
            .collect()
    }

    /// A word a row that takes accumulators to units of `next`.
    pub fn scales(&self, next: f64) -> Vec<u8> {
        let filling = self.shape.rows_filled() - self.biases.len();
        let word = word_of(self.accumulator_scale() / next).to_le_bytes();
        let tiny = Requantizer::TINY.to_bits().to_le_bytes();
        [word.repeat(self.biases.len()), tiny.repeat(filling)].concat()
    }

    /// Accumulators per product of a stored 8-bit weight and an input.
    fn product_unit(&self) -> f64 {
        if self.bytes { 256.0 } else { 1.0 }
    }

    /// Accumulators that an input of 1 in every column causes. // (out)
    fn row_sums(&self) -> Vec<f64> {
        if self.shape.weights == WeightFormat::I4 {
            let numbers = |&word: &u32| (0..8).map(move |c| f64::from(nibble_weight(word, c)));
            let sum = |row: Vec<u32>| row.iter().flat_map(numbers).sum::<f64>();
            let unit = NIBBLE_UNIT / 4096.0;
            return self.nibble_rows().into_iter().map(|row| sum(row) * unit).collect();
        }
        let stored = self.stored_bytes();
        let rows = stored.chunks_exact(usize::from(self.shape.input_count));
        rows.map(|row| row.iter().map(|&weight| f64::from(weight)).sum::<f64>())
            .map(|sum| sum * self.product_unit())
            .collect()
    }

    fn stored_bytes(&self) -> Vec<i8> {
        let stored = |weight: &f64| (weight * BYTE_DEVIATION).round().clamp(-127.0, 127.0) as i8;
        self.weights.iter().map(stored).collect()
    }

    /// Words of 4-bit weights, filled rows included. // (row, octet)
    fn nibble_rows(&self) -> Vec<Vec<u32>> {
        let inputs = usize::from(self.shape.input_count);
        let weight = |row: usize, column: usize| {
            let place = (column < inputs).then_some(row * inputs + column);
            place.and_then(|place| self.weights.get(place)).copied().unwrap_or(0.0)
        };
        let octets = self.shape.columns_filled() / 8;
        let word = |row: usize, octet: usize| {
            nibble_word(std::array::from_fn(|c| weight(row, 8 * octet + c) * NIBBLE_DEVIATION))
        };
        let rows = 0..self.shape.rows_filled();
        rows.map(|row| (0..octets).map(|octet| word(row, octet)).collect()).collect()
    }
}

/// (column, row) → (block of four rows, column, row)
fn by_blocks<Number: Copy>(columns: Vec<Vec<Number>>) -> impl Iterator<Item = Number> {
    let rows = columns.first().map_or(0, Vec::len);
    let blocks = (0..rows).step_by(BLOCK_ROWS);
    let places = blocks.flat_map({
        let columns = columns.len();
        move |block| (0..columns).map(move |column| (block, column))
    });
    places.flat_map(move |(block, column)| columns[column][block..block + BLOCK_ROWS].to_vec())
}

/// Eight weights in units of a nibble, rounded from the lowest place upwards, because each number reaches down into the
/// nibbles below its own.
fn nibble_word(wanted: [f64; 8]) -> u32 {
    let mut columns: [usize; 8] = std::array::from_fn(|column| column);
    columns.sort_by_key(|&column| nibble_shift(column));
    columns.into_iter().fold(0, |word, column| {
        let below = f64::from(nibble_weight(word, column)) / 4096.0;
        let nibble = (wanted[column] - below).round().clamp(-8.0, 7.0) as i32;
        word | (nibble.cast_unsigned() & 0xF) << nibble_shift(column)
    })
}

/// Layer 1 adds up both of its halves.
fn deviation(manifest: &Manifest<'_>, index: usize) -> f64 {
    let inputs = |index: usize| f64::from(manifest.layers[index].input_count);
    match index {
        CODE_LAYER | TIME_LAYER => GAIN / (inputs(CODE_LAYER) + inputs(TIME_LAYER)).sqrt(),
        _ => GAIN / inputs(index).sqrt(),
    }
}

/// A number of mean 0 and standard deviation 1, nearly normal: the sum of four bytes.
pub fn normal(random: &mut Pcg32) -> f64 {
    let sum: u16 = random.next_u32().to_le_bytes().into_iter().map(u16::from).sum();
    // Four times the variance (256² − 1) / 12 of a byte.
    (f64::from(sum) - 510.0) / (4.0f64 * 65_535.0 / 12.0).sqrt()
}
