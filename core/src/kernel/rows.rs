//! Kernels for weights that lie row after row: safe Rust in the shape that LLVM turns into vector instructions.
//!
//! In:  a block of four rows, and activations in their natural order.
//! Out: four accumulators, on the scale of the packed kernels.
//!
//! Why here: Armv8.1-M's VMLADAVA and the SIMD of hosts sum along a row, and need no packing. For the M55 the loop over
//! all four rows becomes ten instructions, LETP included, for 64 products with i8 and 32 with i16; it loads activations
//! once. Written as four loops it has 4 x 4 instructions, and with i16 loses the predicated tail. Inlined into a caller
//! with other kernels it loses that tail, too, and needs four times the instructions (i8): hence `inline(never)`.

/// `sums[r] += Σ w[r][c] · x[c]` over four rows of i8 weights.
///
/// # Shapes
/// `rows` (4, columns) · `activations` (columns); what one has more than the other is ignored.
#[inline(never)]
pub fn w8a16(rows: &[u8], activations: &[i16], sums: &mut [i32; 4]) {
    *sums = add_products(rows, activations, *sums);
}

/// `sums[r] += 256 · Σ w[r][c] · x[c]` over four rows of i8 weights: the scale of the packed `w8a8`.
///
/// # Shapes
/// `rows` (4, columns) · `activations` (columns); what one has more than the other is ignored.
#[inline(never)]
pub fn w8a8(rows: &[u8], activations: &[i8], sums: &mut [i32; 4]) {
    for (sum, product) in sums.iter_mut().zip(add_products(rows, activations, [0; 4])) {
        *sum = sum.wrapping_add(product << 8);
    }
}

#[inline]
fn add_products<Activation>(rows: &[u8], activations: &[Activation], mut sums: [i32; 4]) -> [i32; 4]
where
    Activation: Copy + Into<i32>,
{
    let columns = rows.len() / 4;
    // Of equal length in a way that the optimiser sees; otherwise it does not predicate the tail.
    let (row0, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row1, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row2, rows) = rows.split_at_checked(columns).unwrap_or_default();
    let (row3, _) = rows.split_at_checked(columns).unwrap_or_default();
    let weights = row0.iter().zip(row1).zip(row2).zip(row3);
    for ((((w0, w1), w2), w3), &x) in weights.zip(activations) {
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
    fn empty_blocks_and_missing_activations_leave_sums_alone() {
        let mut sums = [1, 2, 3, 4];
        w8a8(&[], &[9; 3], &mut sums);
        w8a8(&[9; 12], &[], &mut sums);
        w8a16(&[9; 3], &[9; 3], &mut sums);
        assert_eq!(sums, [1, 2, 3, 4]);
    }

    #[test]
    fn sums_wrap() {
        let mut sums = [i32::MAX; 4];
        w8a8(&[0x81; 4], &[-127], &mut sums);
        assert_eq!(sums, [i32::MAX.wrapping_add(256 * 127 * 127); 4]);
        w8a16(&[0x80; 4], &[i16::MIN], &mut sums);
        assert_eq!(sums, [i32::MAX.wrapping_add(256 * 127 * 127).wrapping_add(1 << 22); 4]);
    }

    #[test]
    fn rows_sum_as_the_definition_for_every_length() {
        let mut random = Pcg32::new(3);
        // Miri is slow.
        for columns in (0..70).step_by(if cfg!(miri) { 7 } else { 1 }) {
            let weights: Vec<u8> = (0..4 * columns).map(|_| random.next_u32() as u8).collect();
            let wide: Vec<i16> = (0..columns).map(|_| random.next_u32() as i16).collect();
            let narrow: Vec<i8> = wide.iter().map(|&x| x as i8).collect();
            let (mut sums_a8, mut sums_a16) = ([5; 4], [7; 4]);
            w8a8(&weights, &narrow, &mut sums_a8);
            w8a16(&weights, &wide, &mut sums_a16);
            for row in 0..4 {
                let weight = |column: usize| i64::from(weights[row * columns + column] as i8);
                let sum_a8: i64 = (0..columns).map(|c| weight(c) * i64::from(narrow[c])).sum();
                let sum_a16: i64 = (0..columns).map(|c| weight(c) * i64::from(wide[c])).sum();
                assert_eq!(i64::from(sums_a8[row]), 5 + 256 * sum_a8);
                assert_eq!(i64::from(sums_a16[row]), 7 + sum_a16);
            }
        }
    }
}
