//! What the user types, one file per verb: arguments in, library calls, text out.

pub mod bench;
pub mod clips;
pub mod inspect_clips;
pub mod quantize;
pub mod reconstruct;
pub mod train;
