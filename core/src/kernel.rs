//! The multiply-accumulate loops, one file per processor architecture; everything else in this crate is written once.
//!
//! In:  a *block* (the weights of four rows, packed by `packing.rs`) and activations.
//! Out: four accumulators, updated in place.
//!
//! Why here: nine tenths of a pose's instructions are spent in these loops. `build.rs` chooses the family from the
//! target; [`portable`] is the definition that the others must equal bit for bit, and runs everywhere.
//!
//! # Formats
//! Activations come in *quads*, four halfwords in two words. `x0..x3` are the inputs of columns 0 to 3:
//! * `w8a16`, `w4a8`: `[x0 | x2 << 16, x1 | x3 << 16]`.
//! * `w8a8`: `[d0 | d2 << 16, x1 | x3 << 16]` with `d0 = 256·x0 − x1` and `d2 = 256·x2 − x3`.
//!
//! All sums wrap; the loader has proved for every row that its final sum fits.

pub mod portable;
#[cfg(any(not(karakuri_kernel = "portable"), karakuri_vfp))]
mod assembly;
#[cfg(karakuri_kernel = "armv6m")]
mod armv6m;
#[cfg(karakuri_kernel = "armv7m")]
mod armv7m;
// Cores with vector instructions have the DSP extension as well: tiles, nibbles and pairs run as on the others.
#[cfg(any(karakuri_kernel = "dsp", karakuri_kernel = "vector"))]
mod dsp;
#[cfg(karakuri_vfp)]
mod vfp;

/// Four activations; see the module for the order.
pub type Quad = [u32; 2];

/// Bytes of a tile: four rows by four 8-bit columns, or four rows by eight 4-bit columns.
pub const TILE_BYTES: usize = 16;

/// Tiles of 4-bit weights that share their scales: 64 columns.
pub const GROUP_TILES: usize = 8;

/// Bytes of the scales of a group: a u16 for each of the four rows.
pub const GROUP_SCALE_BYTES: usize = 8;

/// Name of the family that `build.rs` chose.
pub const FAMILY: &str = if cfg!(karakuri_kernel = "dsp") {
    "dsp"
} else if cfg!(karakuri_kernel = "armv7m") {
    "armv7m"
} else if cfg!(karakuri_kernel = "armv6m") {
    "armv6m"
} else if cfg!(karakuri_kernel = "vector") {
    "vector"
} else {
    "portable"
};

/// Whether the family reads [`Packing::Rows`](crate::manifest::Packing::Rows).
pub const TAKES_ROWS: bool = cfg!(karakuri_rows);

/// Bytes at whose multiples a blob must start: the assembly loads whole words.
pub const ALIGNMENT: usize = if cfg!(karakuri_kernel = "portable") { 1 } else { 4 };

#[cfg(karakuri_rows)]
pub mod rows;

#[cfg(not(karakuri_kernel = "portable"))]
pub use assembly::tiles::{w4a8, w8a8, w8a8_pair, w8a16, w8a16_pair};
#[cfg(karakuri_kernel = "portable")]
pub use portable::{w4a8, w8a8, w8a8_pair, w8a16, w8a16_pair};

#[cfg(not(karakuri_vfp))]
pub use portable::f16;
#[cfg(karakuri_vfp)]
pub use vfp::f16;
