//! Standard output: the data of every verb.
//!
//! Why here: `println!` panics when the disk behind it is full or its reader has gone. The one is an error with the
//! system's words, the other is none.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write};

use serde::Serialize;

use crate::error::{Error, Result};

/// Prints as it is; the caller ends its lines.
///
/// # Errors
/// `Io`, but not when the reader closed the pipe: `| head` has seen enough.
pub fn print(data: impl Display) -> Result<()> {
    let mut out = io::stdout().lock();
    match write!(out, "{data}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.map_err(Error::io("write", "standard output")),
    }
}

/// Prints as JSON, for programs.
///
/// # Errors
/// As [`print`].
pub fn print_json(data: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(data).map_err(io::Error::from);
    print(text.map_err(Error::io("write", "standard output"))? + "\n")
}
