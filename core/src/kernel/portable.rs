//! Every kernel in portable Rust: the definition, and what runs where no assembly fits.
//!
//! Source: the packings are described in `packing.rs`; the two multiplications of `w8a8` are the project's own.

use super::{GROUP_SCALE_BYTES, GROUP_TILES, Quad, TILE_BYTES};

/// `sums[r] += Σ w[r][c] · x[c]` over a block of i8 weights, a byte each.
///
/// # Shapes
/// `tiles` 16 bytes a quad · `quads` (columns / 4) · what one has more than the other is ignored.
pub fn w8a16(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    for (tile, &quad) in tiles.as_chunks::<TILE_BYTES>().0.iter().zip(quads) {
        accumulate_w8a16(tile, quad, sums);
    }
}

/// [`w8a16`] for two frames, whose quads alternate.
pub fn w8a16_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    for (tile, pair) in tiles.as_chunks::<TILE_BYTES>().0.iter().zip(quads) {
        for (sums, &quad) in sums.iter_mut().zip(pair) {
            accumulate_w8a16(tile, quad, sums);
        }
    }
}

#[inline]
fn accumulate_w8a16(tile: &[u8], quad: Quad, sums: &mut [i32; 4]) {
    let ([x0, x2], [x1, x3]) = (halves(quad[0]), halves(quad[1]));
    for (row, sum) in tile.as_chunks::<4>().0.iter().zip(sums) {
        let [w0, w1, w2, w3] = row.map(|w| i32::from(w.cast_signed()));
        *sum = sum.wrapping_add(w0 * x0 + w1 * x1 + w2 * x2 + w3 * x3);
    }
}

/// `sums[r] += 256 · Σ w[r][c] · x[c]` over a block of i8 weights, two in each halfword.
///
/// A halfword is `h = 256·w1 + w0`, so `h·x1 + w0·(256·x0 − x1) = 256·(w1·x1 + w0·x0)`: one extraction (of `w0`) for
/// two products, exact.
///
/// # Shapes
/// `tiles` 16 bytes a quad · `quads` (columns / 4) · what one has more than the other is ignored.
pub fn w8a8(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    for (tile, &quad) in tiles.as_chunks::<TILE_BYTES>().0.iter().zip(quads) {
        accumulate_w8a8(tile, quad, sums);
    }
}

/// [`w8a8`] for two frames, whose quads alternate.
pub fn w8a8_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    for (tile, pair) in tiles.as_chunks::<TILE_BYTES>().0.iter().zip(quads) {
        for (sums, &quad) in sums.iter_mut().zip(pair) {
            accumulate_w8a8(tile, quad, sums);
        }
    }
}

#[inline]
fn accumulate_w8a8(tile: &[u8], quad: Quad, sums: &mut [i32; 4]) {
    let ([d0, d2], [x1, x3]) = (halves(quad[0]), halves(quad[1]));
    for (&row, sum) in tile.as_chunks().0.iter().zip(sums) {
        let [h0, h2] = halves(u32::from_le_bytes(row));
        let (w0, w2) = (i32::from(h0 as i8), i32::from(h2 as i8));
        let products = [w0 * d0, h0 * x1, w2 * d2, h2 * x3];
        *sum = products.into_iter().fold(*sum, i32::wrapping_add);
    }
}

/// `sums[r] += Σ over groups of (scale[r] · Σ w[r][c] · x[c]) >> 16`, rounded down, over a block of 4-bit weights.
///
/// A weight is the 16-bit number whose top four bits are its own and whose others are whatever lies below them in the
/// word. Columns (0, 2) are the halves of the word, (1, 3) those of the word shifted left by 4, (4, 6) by 8, (5, 7)
/// by 12.
///
/// # Shapes
/// `tiles` 16 bytes per two quads · `scales` 8 bytes per group of 64 columns · `quads` (columns / 4), even.
pub fn w4a8(tiles: &[u8], scales: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    let groups = tiles.chunks(GROUP_TILES * TILE_BYTES).zip(quads.chunks(2 * GROUP_TILES));
    for ((tiles, quads), scales) in groups.zip(scales.as_chunks::<GROUP_SCALE_BYTES>().0) {
        let mut group_sums = [0; 4];
        for (tile, quads) in tiles.as_chunks::<TILE_BYTES>().0.iter().zip(quads.as_chunks().0) {
            accumulate_w4a8(tile, quads, &mut group_sums);
        }
        for ((sum, group_sum), &scale) in sums.iter_mut().zip(group_sums).zip(scales.as_chunks().0)
        {
            let scale = i64::from(u16::from_le_bytes(scale));
            *sum = sum.wrapping_add(((i64::from(group_sum) * scale) >> 16) as i32);
        }
    }
}

#[inline]
fn accumulate_w4a8(tile: &[u8], quads: &[Quad; 2], sums: &mut [i32; 4]) {
    for (&row, sum) in tile.as_chunks().0.iter().zip(sums) {
        let mut weights = u32::from_le_bytes(row);
        for &activations in quads.iter().flatten() {
            let ([w_low, w_high], [x_low, x_high]) = (halves(weights), halves(activations));
            *sum = sum.wrapping_add(w_low * x_low).wrapping_add(w_high * x_high);
            weights <<= 4;
        }
    }
}

/// `sums[r] = sums[r] + w[r][c] · x[c]` for every column in order, over a block of binary16 weights.
///
/// Product and sum are rounded each (no fused multiply-add), so that FPUs and hosts give the same bits.
///
/// # Shapes
/// `weights` 8 bytes a column, rows 0 to 3 · `activations` (column)
pub fn f16(weights: &[u8], activations: &[f32], sums: &mut [f32; 4]) {
    for (&[a, b, c, d, e, f, g, h], &x) in weights.as_chunks().0.iter().zip(activations) {
        let weights = [[a, b], [c, d], [e, f], [g, h]].map(u16::from_le_bytes).map(binary16);
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum += weight * x;
        }
    }
}

/// The value of a finite binary16, exact, by placing exponent and fraction in an f32 and repairing the bias.
#[inline]
fn binary16(bits: u16) -> f32 {
    const REBIAS: f32 = f32::from_bits((127 + 127 - 15) << 23); // 2^112
    let magnitude = f32::from_bits(u32::from(bits & 0x7FFF) << 13) * REBIAS;
    f32::from_bits(magnitude.to_bits() | u32::from(bits & 0x8000) << 16)
}

/// Low and high halfword, sign-extended.
#[inline]
fn halves(word: u32) -> [i32; 2] {
    [i32::from(word as i16), word.cast_signed() >> 16]
}
