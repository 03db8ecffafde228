//! The kernels of whichever family was built, under one name each.
//!
//! In:  blocks and quads as `kernel.rs` describes them.
//! Out: the sums of [`portable`](crate::kernel::portable), bit for bit.
//!
//! Why here: the families differ in their loops, not in how these are called. Each defines these five symbols.

use super::{nibbles, run};
use crate::kernel::{Quad, TILE_BYTES};

unsafe extern "C" {
    fn karakuri_w8a16(tiles: *const u8, quads: *const Quad, count: usize, sums: &mut [i32; 4]);
    fn karakuri_w8a8(tiles: *const u8, quads: *const Quad, count: usize, sums: &mut [i32; 4]);
    fn karakuri_w8a16_pair(
        tiles: *const u8,
        quads: *const [Quad; 2],
        count: usize,
        sums: &mut [[i32; 4]; 2],
    );
    fn karakuri_w8a8_pair(
        tiles: *const u8,
        quads: *const [Quad; 2],
        count: usize,
        sums: &mut [[i32; 4]; 2],
    );
    fn karakuri_w4a8(
        tiles: *const u8,
        quads: *const Quad,
        count: usize,
        sums: &mut [i32; 4],
        scales: *const u8,
    );
}

/// [`portable::w8a16`](crate::kernel::portable::w8a16).
pub fn w8a16(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    run::<TILE_BYTES, _, _>(karakuri_w8a16, tiles, quads, sums);
}

/// [`portable::w8a8`](crate::kernel::portable::w8a8).
pub fn w8a8(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    run::<TILE_BYTES, _, _>(karakuri_w8a8, tiles, quads, sums);
}

/// [`portable::w8a16_pair`](crate::kernel::portable::w8a16_pair).
pub fn w8a16_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    run::<TILE_BYTES, _, _>(karakuri_w8a16_pair, tiles, quads, sums);
}

/// [`portable::w8a8_pair`](crate::kernel::portable::w8a8_pair).
pub fn w8a8_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    run::<TILE_BYTES, _, _>(karakuri_w8a8_pair, tiles, quads, sums);
}

/// [`portable::w4a8`](crate::kernel::portable::w4a8).
pub fn w4a8(tiles: &[u8], scales: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    nibbles::run(karakuri_w4a8, tiles, scales, quads, sums);
}
