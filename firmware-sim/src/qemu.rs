//! Runs a bare-metal program in QEMU and hands over what it prints.
//!
//! In:  an ELF file from `firmware.rs`.
//! Out: its standard output, line by line, while it runs.
//!
//! Why here: the only file that starts the emulator. It always ends it too, also after a time-out.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::target::Target;

/// The emulator as packages install it.
pub const PROGRAM: &str = "qemu-system-arm";

/// Lines kept for the message of a failed run.
const LOG_LINES: usize = 8;
/// Characters of a line kept for that message: a line of poses says nothing to a human.
const LOG_LINE_LEN: usize = 160;

/// An emulator and the patience with it.
#[derive(Clone, Copy, Debug)]
pub struct Qemu<'a> {
    /// Name or path of the program; [`PROGRAM`] unless there is a reason.
    pub program: &'a str,
    /// A run that takes longer has failed.
    pub time_limit: Duration,
}

impl Qemu<'_> {
    /// Runs `elf` to its end and calls `on_line` with each line of its standard output.
    ///
    /// # Errors
    /// [`Error::MissingTool`] without the emulator; [`Error::Firmware`] after a non-zero exit code or a time-out.
    pub fn run(&self, elf: &Path, target: Target, mut on_line: impl FnMut(&str)) -> Result<()> {
        let mut guest = Guest(self.start(elf, target)?);
        let errors = guest
            .0
            .stderr
            .take()
            .map(|stream| thread::spawn(move || read_all(stream)));
        let lines = guest.0.stdout.take().map(spawn_reader);
        let deadline = Instant::now() + self.time_limit;
        let mut log = Vec::new();
        let in_time = lines.is_some_and(|lines| {
            forward(&lines, deadline, |line| {
                remember(&mut log, line);
                on_line(line);
            })
        });
        if !in_time {
            let reason = format!("no end after {} s", self.time_limit.as_secs());
            return Err(Error::Firmware {
                reason,
                log: log.join("\n"),
            });
        }
        let status = guest
            .0
            .wait()
            .map_err(Error::io("wait for", self.program))?;
        if status.success() {
            return Ok(());
        }
        let errors = errors
            .and_then(|thread| thread.join().ok())
            .unwrap_or_default();
        errors.lines().for_each(|line| remember(&mut log, line));
        Err(Error::Firmware {
            reason: status.to_string(),
            log: log.join("\n"),
        })
    }

    /// Finds out before a long build.
    ///
    /// # Errors
    /// [`Error::MissingTool`].
    pub fn check_installed(&self) -> Result<()> {
        let output = Command::new(self.program).arg("--version").output();
        output.map(drop).map_err(|error| self.cannot_start(error))
    }

    fn start(&self, elf: &Path, target: Target) -> Result<Child> {
        Command::new(self.program)
            .args(["-machine", target.machine(), "-cpu", target.emulated_core()])
            .args(["-display", "none", "-monitor", "none", "-serial", "null"])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| self.cannot_start(error))
    }

    fn cannot_start(&self, error: io::Error) -> Error {
        if error.kind() != io::ErrorKind::NotFound {
            return Error::io("start", self.program)(error);
        }
        Error::MissingTool {
            what: self.program.to_owned(),
            remedy: "on Debian and Ubuntu run `apt-get install -y qemu-system-arm`".to_owned(),
        }
    }
}

/// A running emulator that does not outlive its owner.
struct Guest(Child);

impl Drop for Guest {
    fn drop(&mut self) {
        // Both fail only for a process that has ended already, which is what is wanted.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Reads in a thread of its own, because a pipe cannot be read with a time limit.
fn spawn_reader(stdout: ChildStdout) -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(stdout).lines().map_while(|line| line.ok()) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

/// Hands lines on until the stream ends (true) or the deadline passes (false).
fn forward(lines: &Receiver<String>, deadline: Instant, mut on_line: impl FnMut(&str)) -> bool {
    loop {
        match lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => on_line(&line),
            Err(RecvTimeoutError::Disconnected) => return true,
            Err(RecvTimeoutError::Timeout) => return false,
        }
    }
}

fn read_all(mut stream: impl Read) -> String {
    let mut text = String::new();
    // What cannot be read cannot be reported; the exit code still is.
    let _ = stream.read_to_string(&mut text);
    text
}

fn remember(log: &mut Vec<String>, line: &str) {
    if log.len() == LOG_LINES {
        log.remove(0);
    }
    log.push(line.chars().take(LOG_LINE_LEN).collect());
}
