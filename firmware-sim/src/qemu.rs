//! Runs a bare-metal program in QEMU and hands over what it prints.
//!
//! In:  an ELF file from `firmware.rs`; for a benchmark also a blob and the plugin of `plugin.rs`.
//! Out: its standard output, line by line, while it runs.
//!
//! Why here: the only file that starts the emulator. It always ends it too, also after a fault.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::Duration;

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
    /// A program that prints nothing for so long has failed.
    pub silence_max: Duration,
}

/// What a run has beside its program.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extras<'a> {
    /// A file that lies in memory before reset, and where.
    pub memory: Option<(&'a Path, u64)>,
    /// A plugin and the file that it writes.
    pub plugin: Option<(&'a Path, &'a Path)>,
}

impl Qemu<'_> {
    /// Runs `elf` to its end and calls `on_line` with each line of its standard output.
    ///
    /// # Errors
    /// [`Error::MissingTool`] without the emulator; [`Error::Firmware`] after a non-zero exit code or a long silence.
    pub fn run(&self, elf: &Path, target: Target, on_line: impl FnMut(&str)) -> Result<()> {
        self.run_with(Extras::default(), elf, target, on_line)
    }

    /// [`run`](Self::run), with more than the program.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn run_with(
        &self,
        extras: Extras<'_>,
        elf: &Path,
        target: Target,
        on_line: impl FnMut(&str),
    ) -> Result<()> {
        Guest(self.start(extras, elf, target)?).watch(self.silence_max, on_line)
    }

    /// Finds out before a long build.
    ///
    /// # Errors
    /// [`Error::MissingTool`].
    pub fn check_installed(&self) -> Result<()> {
        self.version().map(drop)
    }

    /// What it says about its version.
    ///
    /// # Errors
    /// [`Error::MissingTool`].
    pub fn version(&self) -> Result<String> {
        let output = Command::new(self.program).arg("--version").output();
        let output = output.map_err(|error| self.cannot_start(error))?;
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }

    fn start(&self, extras: Extras<'_>, elf: &Path, target: Target) -> Result<Child> {
        Command::new(self.program)
            .args(["-machine", target.machine(), "-cpu", target.emulated_core()])
            .args(["-display", "none", "-monitor", "none", "-serial", "null"])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(elf)
            .args(extras.arguments())
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

impl Extras<'_> {
    fn arguments(&self) -> Vec<OsString> {
        let memory = self.memory.map(|(file, address)| {
            let head = OsString::from("loader,force-raw=on,file=");
            let tail = OsString::from(format!(",addr={address:#x}"));
            ["-device".into(), [head, option_value(file), tail].into_iter().collect()]
        });
        let plugin = self.plugin.map(|(file, out)| {
            let parts = [option_value(file), ",out=".into(), option_value(out)];
            ["-plugin".into(), parts.into_iter().collect()]
        });
        memory.into_iter().chain(plugin).flatten().collect()
    }
}

/// A path inside a list of options, where QEMU takes a comma for the end of a value unless it is doubled.
fn option_value(path: &Path) -> OsString {
    path.to_string_lossy().replace(',', ",,").into()
}

/// A running emulator that does not outlive its owner.
struct Guest(Child);

impl Guest {
    /// Forwards its output until it ends, well and in time.
    fn watch(mut self, silence_max: Duration, mut on_line: impl FnMut(&str)) -> Result<()> {
        let errors = self.0.stderr.take().map(|stream| thread::spawn(move || read_all(stream)));
        let lines = self.0.stdout.take().map(spawn_reader);
        let mut log = Vec::new();
        let has_ended = lines.is_some_and(|lines| {
            forward(&lines, silence_max, |line| {
                remember(&mut log, line);
                on_line(line);
            })
        });
        if !has_ended {
            let reason = format!("silent for {} s", silence_max.as_secs());
            return Err(Error::Firmware { reason, log: log.join("\n") });
        }
        let status = self.0.wait().map_err(Error::io("wait for", PROGRAM))?;
        if status.success() {
            return Ok(());
        }
        let errors = errors.and_then(|thread| thread.join().ok()).unwrap_or_default();
        errors.lines().for_each(|line| remember(&mut log, line));
        Err(Error::Firmware { reason: status.to_string(), log: log.join("\n") })
    }
}

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

/// Hands lines on until the stream ends (true) or is silent for too long (false).
fn forward(lines: &Receiver<String>, silence_max: Duration, mut on_line: impl FnMut(&str)) -> bool {
    loop {
        match lines.recv_timeout(silence_max) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    const ABSENT: Qemu<'_> =
        Qemu { program: "qemu-system-arm-that-nobody-installed", silence_max: Duration::ZERO };

    #[test]
    fn missing_qemu_names_the_package_to_install() {
        for outcome in
            [ABSENT.check_installed(), ABSENT.run(Path::new("x"), Target::CortexM4, |_| ())]
        {
            let error = outcome.unwrap_err();
            assert!(error.is_missing_tool());
            assert!(error.to_string().contains("apt-get install -y qemu-system-arm"), "{error}");
        }
    }

    /// Any program will do to watch.
    fn watch(script: &str, silence_max: Duration) -> Result<Vec<String>> {
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut lines = Vec::new();
        let on_line = |line: &str| lines.push(line.to_owned());
        Guest(command.spawn().unwrap()).watch(silence_max, on_line)?;
        Ok(lines)
    }

    #[test]
    fn emulator_that_falls_silent_is_killed() {
        let start = Instant::now();
        let error = watch("exec sleep 60", Duration::from_millis(50)).unwrap_err();
        assert!(error.to_string().contains("silent for 0 s"), "{error}");
        assert!(start.elapsed() < Duration::from_secs(30));
    }

    #[test]
    fn failed_run_shows_exit_code_and_what_was_said_last() {
        let script = "echo error blob; echo panicked >&2; exit 101";
        let error = watch(script, Duration::from_secs(60)).unwrap_err().to_string();
        for part in ["101", "error blob", "panicked"] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn path_with_a_comma_stays_one_path() {
        let path = Path::new("a,b");
        let extras = Extras { memory: Some((path, 0x40000)), plugin: Some((path, path)) };
        let device = "loader,force-raw=on,file=a,,b,addr=0x40000";
        assert_eq!(extras.arguments(), ["-device", device, "-plugin", "a,,b,out=a,,b"]);
    }

    #[test]
    fn lines_arrive_in_order() {
        let lines = watch("echo one; echo two", Duration::from_secs(60)).unwrap();
        assert_eq!(lines, ["one", "two"]);
    }
}
