//! One file per verb of the command line: reads files, shows progress, prints the result.

pub mod bench;
pub mod compare;
pub mod perform;
pub mod run;
#[cfg(unix)]
pub mod serve;
pub mod trace;

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::error::{Error, Result};

/// A bar on standard error that also shows life while nothing is counted.
fn progress_bar() -> ProgressBar {
    let template = "{spinner} {msg} {wide_bar} {pos}/{len} {eta}";
    let style = ProgressStyle::with_template(template);
    let bar =
        ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

fn read_blob(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(Error::io("read", path))
}

/// Prints data. A full disk is an error where `println!` panics; a reader that closed the pipe is none.
fn print(data: impl AsRef<[u8]>) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(data.as_ref()).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.map_err(Error::io("write", "standard output")),
    }
}

fn print_json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(io::Error::from);
    print(text.map_err(Error::io("write", "standard output"))? + "\n")
}
