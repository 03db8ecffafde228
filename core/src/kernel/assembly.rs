//! How kernels in assembly are called: what they may read, and weights that are not word-aligned.
//!
//! In:  a kernel, and the slices of a call.
//! Out: the kernel's sums.
//!
//! Why here: LDM and VLDM fault at odd addresses, and on Armv6-M every load does. The loader refuses such a blob, but a
//! result must not depend on an address: weights elsewhere are copied a tile at a time, which costs less flash than
//! linking the portable loops as well.
//!
//! # Safety
//! A kernel of this crate reads `count` units of weights (tiles, columns, tiles of nibbles) and their activations, for
//! nibbles two quads each and the scales of every group begun. All were counted in the slices, and weights and scales
//! are aligned to what the kernel loads; activations are by their types. Sums are an exclusive borrow. Kernels keep the
//! procedure call standard (AAPCS32): r4 to r11, s16 to s31 and the stack pointer are restored, and nothing but the
//! sums and their own stack is written.

#![allow(unsafe_code)]

#[cfg(not(karakuri_kernel = "portable"))]
mod nibbles;
#[cfg(not(karakuri_kernel = "portable"))]
pub mod tiles;

/// A kernel: aligned weights, activations, how many units there are of both (at least one), sums.
pub type Kernel<Activations, Sums> =
    unsafe extern "C" fn(*const u8, *const Activations, usize, &mut Sums);

#[repr(C, align(4))]
struct Aligned<Bytes>(Bytes);

fn is_aligned(bytes: &[u8]) -> bool {
    bytes.as_ptr().cast::<u32>().is_aligned()
}

/// Calls one of this crate's kernels with the units of `UNIT_BYTES` that both sides have.
#[inline]
pub fn run<const UNIT_BYTES: usize, Activations, Sums>(
    kernel: Kernel<Activations, Sums>,
    weights: &[u8],
    activations: &[Activations],
    sums: &mut Sums,
) {
    if !is_aligned(weights) {
        return run_by_unit::<UNIT_BYTES, _, _>(kernel, weights, activations, sums);
    }
    let count = (weights.len() / UNIT_BYTES).min(activations.len());
    if count > 0 {
        // SAFETY: see the module.
        unsafe { kernel(weights.as_ptr(), activations.as_ptr(), count, sums) }
    }
}

#[cold]
#[inline(never)]
fn run_by_unit<const UNIT_BYTES: usize, Activations, Sums>(
    kernel: Kernel<Activations, Sums>,
    weights: &[u8],
    activations: &[Activations],
    sums: &mut Sums,
) {
    for (bytes, activations) in weights.chunks_exact(UNIT_BYTES).zip(activations) {
        let mut unit = Aligned([0; UNIT_BYTES]);
        // As a plain loop this would be a call of `memcpy`, ten times the size of this function.
        unit.0.iter_mut().zip(bytes).for_each(|(to, from)| *to = core::hint::black_box(*from));
        // SAFETY: one unit and its activations; see the module.
        unsafe { kernel(unit.0.as_ptr(), activations, 1, sums) }
    }
}
