//! One file a command line verb: arguments in, library calls, words out.

pub mod train;
pub mod bench;
