//! What the assembly kernels check before they read: how many tiles both sides have, and that words are aligned.
//!
//! In:  weights, scales and the number of quads of a call.
//! Out: the number of tiles, or none if portable Rust has to do it.
//!
//! Why here: loads of several words fault at odd addresses, on Armv6-M every load does. The loader refuses such a blob;
//! a caller who passes one all the same gets the same sums, slowly.

use super::{GROUP_SCALE_BYTES, GROUP_TILES, TILE_BYTES};

/// Tiles of 8-bit weights that have a quad; none if there are none, or if the tiles are not word-aligned.
pub fn tile_count(tiles: &[u8], quads: usize) -> Option<usize> {
    let count = (tiles.len() / TILE_BYTES).min(quads);
    (count > 0 && tiles.as_ptr().cast::<u32>().is_aligned()).then_some(count)
}

/// Tiles of 4-bit weights that have two quads and scales; as [`tile_count`] else, with scales aligned as their u16.
pub fn nibble_tile_count(tiles: &[u8], scales: &[u8], quads: usize) -> Option<usize> {
    let scaled = scales.len() / GROUP_SCALE_BYTES * GROUP_TILES;
    let is_aligned = scales.as_ptr().cast::<u16>().is_aligned();
    tile_count(tiles, (quads / 2).min(scaled)).filter(|_| is_aligned)
}
