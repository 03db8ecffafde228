//! The director's desk: lines of a script → commands to a body at the other end of a serial line.
//!
//! In:  lines of a file or of a terminal; reports of the body.
//! Out: frames of `karakuri::link`.
//!
//! Why here: what is tried in the simulator (`firmware-sim perform`) is told to the real body in the same words.

pub mod session;
pub mod script;
