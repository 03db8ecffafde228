//! How kernels of 4-bit weights are called.
//!
//! In:  a kernel, and the slices of a call.
//! Out: the kernel's sums.
//!
//! Why here: these have one argument more, and weights that are not word-aligned are copied a group at a time. What
//! makes a call safe stands in [`assembly`](super).

use super::{Aligned, is_aligned};
use crate::kernel::{GROUP_SCALE_BYTES, GROUP_TILES, Quad, TILE_BYTES};

/// A kernel of 4-bit weights: aligned tiles, quads, how many tiles there are (at least one), sums, aligned scales.
pub type Kernel = unsafe extern "C" fn(*const u8, *const Quad, usize, &mut [i32; 4], *const u8);

/// Calls one of this crate's kernels with the tiles that all sides have.
#[inline]
pub fn run(kernel: Kernel, tiles: &[u8], scales: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    if !is_aligned(tiles) || !is_aligned(scales) {
        return run_by_group(kernel, tiles, scales, quads, sums);
    }
    let scaled = scales.len() / GROUP_SCALE_BYTES * GROUP_TILES;
    let count = (tiles.len() / TILE_BYTES).min(quads.len() / 2).min(scaled);
    if count > 0 {
        // SAFETY: see the module.
        unsafe { kernel(tiles.as_ptr(), quads.as_ptr(), count, sums, scales.as_ptr()) }
    }
}

#[cold]
fn run_by_group(kernel: Kernel, tiles: &[u8], scales: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    let groups = tiles.chunks(GROUP_TILES * TILE_BYTES).zip(quads.chunks(2 * GROUP_TILES));
    for ((tiles, quads), scales) in groups.zip(scales.chunks_exact(GROUP_SCALE_BYTES)) {
        let mut copy = Aligned([0; GROUP_TILES * TILE_BYTES]);
        let mut scales_copy = Aligned([0; GROUP_SCALE_BYTES]);
        copy.0.iter_mut().zip(tiles).for_each(|(copy, byte)| *copy = *byte);
        scales_copy.0.copy_from_slice(scales);
        let count = (tiles.len() / TILE_BYTES).min(quads.len() / 2);
        if count > 0 {
            // SAFETY: the copies hold a whole group; see the module.
            unsafe { kernel(copy.0.as_ptr(), quads.as_ptr(), count, sums, scales_copy.0.as_ptr()) }
        }
    }
}
