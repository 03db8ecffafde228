//! A pair of ends that behaves like a serial line: one is ours, the other has a path for programs to open.
//!
//! Why here: `host-trainer perform` is tested with the same system calls that a real port sees.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver};
use std::thread;

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// Our end, and where the other one is.
pub struct PseudoTerminal {
    /// Writes to the other end.
    pub line: File,
    /// What the other end sends.
    pub heard: Receiver<Vec<u8>>,
    /// For the other end.
    pub path: PathBuf,
    /// Open, so that the line outlives the programs that come and go.
    _other: OwnedFd,
}

impl PseudoTerminal {
    /// Opens a pair that passes bytes as they are.
    ///
    /// # Errors
    /// What the system says.
    pub fn open() -> io::Result<Self> {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        let name = ptsname(&ours, Vec::new())?;
        let path = PathBuf::from(name.to_str().map_err(io::Error::other)?);
        let other = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
        let mut attributes = tcgetattr(&other)?;
        attributes.make_raw();
        tcsetattr(&other, OptionalActions::Now, &attributes)?;
        let line = File::from(ours);
        let heard = listen(line.try_clone()?);
        Ok(Self { line, heard, path, _other: other })
    }
}

/// Reads on a thread of its own, because a read waits.
fn listen(mut line: File) -> Receiver<Vec<u8>> {
    let (sender, heard) = mpsc::channel();
    thread::spawn(move || {
        let mut buffer = [0; 256];
        while let Ok(count) = line.read(&mut buffer) {
            if count == 0 || sender.send(buffer[..count].to_vec()).is_err() {
                break;
            }
        }
    });
    heard
}
