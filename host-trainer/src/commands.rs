//! What the user types, one file per verb: arguments in, library calls, text out.

pub mod inspect_clips;
pub mod train;
pub mod bench;
