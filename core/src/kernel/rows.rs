//! Kernels for blocks whose four rows lie one after another: safe loops that compilers turn into vector instructions.
//!
//! In:  four rows of i8 weights, and activations in their natural order.
//! Out: four accumulators, on the same scale as those of the packed kernels.
//!
//! Why here: for Cortex-M55 LLVM makes of the loop below ten instructions (VLDRB, VMLADAVA, LETP) that multiply 4 x 16
//! weights with i8 and 4 x 8 with i16, the last ones predicated. One loop over four rows loads activations once and
//! is measurably shorter than four loops, of which those with i16 lose the predication.

/// `sums[r] += 256 · Σ w[r][c] · x[c]`, as [`super::portable::w8a8`] has it.
///
/// # Shapes
/// `rows` (4, `columns`), a byte each, i8 · `activations` (columns). Of an incomplete block nothing
/// is added; further bytes are ignored.
pub fn w8a8_rows(rows: &[u8], columns: usize, activations: &[i8], sums: &mut [i32; 4]) {
    let products = add_products(rows, columns, activations, [0; 4]);
    for (sum, product) in sums.iter_mut().zip(products) {
        *sum = sum.wrapping_add(product << 8);
    }
}

/// `sums[r] += Σ w[r][c] · x[c]`, as [`super::portable::w8a16`] has it.
///
/// # Shapes
/// As [`w8a8_rows`].
pub fn w8a16_rows(rows: &[u8], columns: usize, activations: &[i16], sums: &mut [i32; 4]) {
    *sums = add_products(rows, columns, activations, *sums);
}

#[inline]
fn add_products<X>(rows: &[u8], columns: usize, activations: &[X], mut sums: [i32; 4]) -> [i32; 4]
where
    X: Copy + Into<i32>,
{
    let (row0, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row1, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row2, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row3, _) = rows.split_at_checked(columns).unwrap_or_default();
    for ((((w0, w1), w2), w3), &x) in row0.iter().zip(row1).zip(row2).zip(row3).zip(activations) {
        let x = x.into();
        for (sum, weight) in sums.iter_mut().zip([w0, w1, w2, w3]) {
            *sum = sum.wrapping_add(i32::from(weight.cast_signed()) * x);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;
    use std::vec::Vec;

    #[test]
    fn empty_and_incomplete_blocks_leave_sums_alone() {
        let mut sums = [1, 2, 3, 4];
        w8a8_rows(&[], 0, &[], &mut sums);
        w8a8_rows(&[9; 11], 3, &[9; 3], &mut sums);
        w8a16_rows(&[9; 11], 3, &[9; 3], &mut sums);
        w8a16_rows(&[9; 12], usize::MAX, &[9; 3], &mut sums);
        assert_eq!(sums, [1, 2, 3, 4]);
    }

    #[test]
    fn sums_wrap() {
        let mut sums = [i32::MAX; 4];
        w8a8_rows(&[0x81; 4], 1, &[-127], &mut sums);
        assert_eq!(sums, [i32::MAX.wrapping_add(256 * 127 * 127); 4]);
        w8a16_rows(&[0x80; 4], 1, &[i16::MIN], &mut sums);
        assert_eq!(sums, [i32::MAX.wrapping_add(256 * 127 * 127).wrapping_add(1 << 22); 4]);
    }

    #[test]
    fn rows_sum_as_the_definition_for_every_length() {
        let mut random = Pcg32::new(3);
        for columns in 0..70 {
            let weights: Vec<u8> = (0..4 * columns).map(|_| random.next_u32() as u8).collect();
            let activations: Vec<i16> = (0..columns).map(|_| random.next_u32() as i16).collect();
            let narrow: Vec<i8> = activations.iter().map(|&x| x as i8).collect();
            let (mut sums_a8, mut sums_a16) = ([5; 4], [7; 4]);
            w8a8_rows(&weights, columns, &narrow, &mut sums_a8);
            w8a16_rows(&weights, columns, &activations, &mut sums_a16);
            for row in 0..4 {
                let row_weights = &weights[row * columns..][..columns];
                let sum = |x: &dyn Fn(usize) -> i64| -> i64 {
                    let products = row_weights.iter().enumerate();
                    products.map(|(column, &w)| i64::from(w as i8) * x(column)).sum()
                };
                assert_eq!(i64::from(sums_a8[row]), 5 + 256 * sum(&|c| narrow[c].into()));
                assert_eq!(i64::from(sums_a16[row]), 7 + sum(&|c| activations[c].into()));
            }
        }
    }
}
