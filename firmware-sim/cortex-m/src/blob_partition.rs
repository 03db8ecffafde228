//! A blob in a part of flash of its own, which is written apart from the program.
//!
//! In:  the linker's symbol `_blob_partition`; there the length of the blob as a little-endian u32, zeros up to 16
//!      bytes, and the blob. `firmware_sim::firmware` knows the same layout.
//! Out: the blob's bytes, not yet checked.
//!
//! Why here: one program serves every blob, and its size in flash is the code's alone. The only file that turns an
//! address into bytes, so that its safety argument stands beside it.

#![allow(unsafe_code)]

use core::{ptr, slice};

/// Bytes before the blob.
const HEADER_BYTES: usize = 16;

unsafe extern "C" {
    /// First word of the partition.
    static _blob_partition: u32;
}

/// The blob in the partition.
pub fn blob() -> &'static [u8] {
    let start = &raw const _blob_partition;
    // SAFETY: the memory map puts the partition into flash, 4-byte aligned, behind everything that the linker places;
    // QEMU fills it before reset with a length and as many bytes, and nothing writes there afterwards. The read is
    // volatile because the compiler knows nothing of this memory.
    unsafe {
        let length = ptr::read_volatile(start) as usize;
        slice::from_raw_parts(start.cast::<u8>().add(HEADER_BYTES), length)
    }
}
