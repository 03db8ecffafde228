//! Ways to store the codes of all clips.
//!
//! In:  one code a clip.
//! Out: [`Coded`]: the codes as they come back, the error of each dimension, the bytes.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::column::fit_columns;
use crate::checkpoint::Checkpoint;
use crate::mixture::k_means::{Points, cluster};

/// Seed of k-means; codes are coded the same way in every call.
const SEED: u64 = 1;
/// Bytes of the device's record of a column: step, least value, bits.
const COLUMN_BYTES: usize = 8;

/// How codes are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coding {
    /// So many bits a number on average, more where a column needs more; rows fill whole bytes.
    Columns {
        /// At most 8.
        bits_mean: f64,
    },
    /// The same of what an action's mean leaves.
    Residual {
        /// At most 8.
        bits_mean: f64,
    },
    /// `dimensions` neighbouring numbers together as one of 256 centres found by k-means.
    Product {
        /// Numbers that share a byte.
        dimensions: usize,
    },
}

/// Codes as a device would read them.
#[derive(Clone, Debug)]
pub struct Coded {
    /// For reports.
    pub name: String,
    /// // (clip)(dimension)
    pub rows: Vec<Vec<f64>>,
    /// Mean over the clips. // (dimension)
    pub square_errors: Vec<f64>,
    /// Of everything that grows with clips, dimensions or actions.
    pub bytes: usize,
}

impl Coding {
    /// Stores `rows`; `deviations` are the noise that is added to each dimension of a draw.
    pub fn code(self, checkpoint: &Checkpoint, rows: &[Vec<f64>], deviations: &[f64]) -> Coded {
        match self {
            Self::Columns { bits_mean } => columns(rows, deviations, bits_mean),
            Self::Residual { bits_mean } => residual(checkpoint, rows, deviations, bits_mean),
            Self::Product { dimensions } => product(rows, deviations, dimensions.max(1)),
        }
    }
}

fn columns(rows: &[Vec<f64>], deviations: &[f64], bits_mean: f64) -> Coded {
    let columns = fit_columns(rows, deviations, bits_mean);
    let bits: usize = columns.iter().map(|(column, _)| usize::from(column.bits)).sum();
    let round = |row: &Vec<f64>| {
        row.iter().zip(&columns).map(|(value, (column, _))| column.round(*value)).collect()
    };
    Coded {
        name: format!("{:.1} bits a number", bits as f64 / deviations.len().max(1) as f64),
        rows: rows.iter().map(round).collect(),
        square_errors: columns.iter().map(|(_, error)| *error).collect(),
        bytes: rows.len() * bits.div_ceil(8) + COLUMN_BYTES * columns.len(),
    }
}

fn residual(
    checkpoint: &Checkpoint,
    rows: &[Vec<f64>],
    deviations: &[f64],
    bits_mean: f64,
) -> Coded {
    let actions: Vec<usize> = checkpoint.dataset.clips.iter().map(|clip| clip.action).collect();
    let action_count = checkpoint.dataset.actions.len();
    let means = means_of_groups(rows, &actions, action_count);
    let shifted = |sign: f64, rows: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let row = |(row, action): (&Vec<f64>, &usize)| {
            row.iter().zip(&means[*action]).map(|(value, mean)| value + sign * mean).collect()
        };
        rows.iter().zip(&actions).map(row).collect()
    };
    let coded = columns(&shifted(-1.0, rows), deviations, bits_mean);
    Coded {
        name: format!("{} from the action's mean", coded.name),
        rows: shifted(1.0, &coded.rows),
        bytes: coded.bytes + 2 * action_count * deviations.len(),
        ..coded
    }
}

fn product(rows: &[Vec<f64>], deviations: &[f64], dimensions: usize) -> Coded {
    let mut coded: Vec<Vec<f64>> = vec![Vec::new(); rows.len()];
    let mut bytes = 0;
    for (part, noise) in deviations.chunks(dimensions).enumerate() {
        let start = part * dimensions;
        let rows_of_part = rows.iter().map(|row| row[start..start + noise.len()].to_vec());
        let rows_of_part: Vec<Vec<f64>> = rows_of_part.collect();
        let scaled = rows_of_part.iter().flat_map(|row| {
            row.iter().zip(noise).map(|(value, deviation)| value / deviation.max(1e-6))
        });
        let values: Vec<f64> = scaled.collect();
        let points = Points { dimension_count: noise.len(), values: &values };
        let groups = cluster(&points, 256, &mut ChaCha8Rng::seed_from_u64(SEED));
        let centres = means_of_groups(&rows_of_part, &groups, 256);
        for (row, group) in coded.iter_mut().zip(&groups) {
            row.extend(&centres[*group]);
        }
        bytes += rows.len() + 256 * noise.len();
    }
    Coded {
        name: format!("{dimensions} numbers a byte by k-means"),
        square_errors: square_errors(rows, &coded),
        rows: coded,
        bytes,
    }
}

/// Means of the rows of every group; zeros where a group has none. // (group)(dimension)
fn means_of_groups(rows: &[Vec<f64>], groups: &[usize], group_count: usize) -> Vec<Vec<f64>> {
    let dimensions = rows.first().map_or(0, Vec::len);
    let mut means = vec![vec![0.0; dimensions]; group_count];
    let mut counts = vec![0.0_f64; group_count];
    for (row, &group) in rows.iter().zip(groups) {
        counts[group] += 1.0;
        means[group].iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    for (mean, count) in means.iter_mut().zip(counts) {
        mean.iter_mut().for_each(|sum| *sum /= count.max(1.0));
    }
    means
}

fn square_errors(rows: &[Vec<f64>], coded: &[Vec<f64>]) -> Vec<f64> {
    let mut errors = vec![0.0; rows.first().map_or(0, Vec::len)];
    for (row, coded) in rows.iter().zip(coded) {
        for ((error, value), coded) in errors.iter_mut().zip(row).zip(coded) {
            *error += (value - coded).powi(2) / rows.len() as f64;
        }
    }
    errors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::code_rows;
    use crate::sampler::nearest_clips::shared_deviations;
    use crate::train::synthetic::{config, dataset};

    /// A checkpoint whose codes differ from clip to clip.
    fn checkpoint() -> Checkpoint {
        let mut checkpoint = Checkpoint::start(&dataset(), &config(""));
        for (index, value) in checkpoint.sequence_codes.mean.iter_mut().enumerate() {
            *value = (index as f32 * 0.7).sin() * 3.0;
        }
        checkpoint
    }

    #[test]
    fn every_coding_returns_every_clip_with_the_error_that_it_states() {
        let checkpoint = checkpoint();
        let rows = code_rows(&checkpoint);
        let deviations = shared_deviations(&checkpoint.sequence_codes);
        let codings = [
            Coding::Columns { bits_mean: 4.0 },
            Coding::Residual { bits_mean: 4.0 },
            Coding::Product { dimensions: 2 },
        ];
        for coding in codings {
            let coded = coding.code(&checkpoint, &rows, &deviations);
            let errors = square_errors(&rows, &coded.rows);
            assert_eq!(coded.rows.len(), rows.len());
            for (error, stated) in errors.iter().zip(&coded.square_errors) {
                assert!((error - stated).abs() < 1e-9, "{coding:?}: {error} is not {stated}");
            }
        }
    }

    #[test]
    fn more_bits_make_smaller_errors_and_more_bytes() {
        let checkpoint = checkpoint();
        let rows = code_rows(&checkpoint);
        let code = |bits_mean| {
            let deviations = vec![1e-3; rows[0].len()];
            Coding::Columns { bits_mean }.code(&checkpoint, &rows, &deviations)
        };
        let sums = [2.0, 4.0, 8.0].map(|bits| code(bits).square_errors.iter().sum::<f64>());
        assert!(sums[0] > 4.0 * sums[1] && sums[1] > 4.0 * sums[2], "{sums:?}");
        assert!(code(2.0).bytes < code(8.0).bytes);
    }
}
