//! `host-trainer perform --serial PORT`: tells a body at a serial line what to do.

use std::fs;
use std::io::{BufRead as _, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use karakuri::Model;
use karakuri::link::{Command, Refusal, Report};
use serde::Serialize;

use crate::error::{Error, Result};
use crate::inspect::blob::{load, read_blob};
use crate::perform::script::{Cue, HELP, Reader, Wrong};
use crate::perform::session::Session;
use crate::stdout::print_json;

/// How long the port waits for a byte.
const READ_TIME: Duration = Duration::from_millis(10);

/// How long to listen after the last line of a script.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// Arguments of `perform`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = HELP)]
pub struct PerformArgs {
    /// Serial port of the body, or the pseudo-terminal of `firmware-sim serve`.
    #[arg(long, value_name = "PORT")]
    pub serial: PathBuf,
    /// Speed of the port, bits a second.
    #[arg(long, default_value_t = 115_200)]
    pub baud: u32,
    /// Blob that the body plays from: names its actions, and is compared with what the body says.
    #[arg(long, value_name = "FILE.kara")]
    pub model: Option<PathBuf>,
    /// Blob to send first: the body, which must be relaxed, takes it in place of its own and plays on from it.
    #[arg(long, value_name = "FILE.kara", conflicts_with = "model")]
    pub load: Option<PathBuf>,
    /// Script to play; without it, lines of standard input are obeyed as they come.
    #[arg(long, value_name = "FILE")]
    pub script: Option<PathBuf>,
    /// Print what happened as JSON on standard output.
    #[arg(long)]
    pub json: bool,
}

/// What happened.
#[derive(Clone, Debug, Default, Serialize)]
struct Outcome {
    loaded_bytes: usize,
    commands: u32,
    refused: u32,
    resent: u32,
    faults: Vec<u16>,
    /// Of the last telemetry.
    ticks: u32,
    interventions: u32,
    broken_frames: u32,
    pulses_us: Vec<u16>,
}

/// Sends a blob if there is one to send, then plays a script, or what is typed.
///
/// # Errors
/// A blob or a script that cannot be read, a port that fails, a body that does not answer, that refuses the blob, that
/// plays from another model, or that refuses a line of a script; it is then told to stop.
pub fn run(args: &PerformArgs) -> Result<()> {
    let played = args.load.as_deref().or(args.model.as_deref());
    let blob = played.map(|path| Ok((path, read_blob(path)?))).transpose()?;
    let model = blob.as_ref().map(|(path, blob)| load(path, blob)).transpose()?;
    let mut reader = Reader::new(model.as_ref());
    let script = args.script.as_deref().map(|path| read_script(path, &mut reader)).transpose()?;
    let open = serialport::new(args.serial.to_string_lossy(), args.baud).timeout(READ_TIME).open();
    let port = open.map_err(|error| Error::io("open", &args.serial)(error.into()))?;
    let mut stage = Stage {
        session: Session::open(port, &args.serial)?,
        start: Instant::now(),
        outcome: Outcome::default(),
    };
    if let (Some(_), Some((path, blob))) = (&args.load, &blob) {
        stage.load(path, blob)?;
    }
    stage.greet(model.as_ref(), &args.serial)?;
    match script {
        Some(cues) => stage.play(&cues)?,
        None => stage.obey_terminal(&mut reader)?,
    }
    stage.outcome.resent = stage.session.resent();
    if args.json { print_json(&stage.outcome) } else { Ok(()) }
}

fn read_script(path: &Path, reader: &mut Reader<'_, '_>) -> Result<Vec<Cue>> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    let mut cues = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let cue = reader.read(line).map_err(|Wrong { value, expected }| {
            let field = format!("line {}", index + 1);
            let remedy = "see `host-trainer perform --help` for the words of a script";
            Error::bad_input(path, field, value, expected, remedy)
        })?;
        cues.extend(cue);
    }
    Ok(cues)
}

/// The body's model with the user's, where the report says which it is.
fn compare(report: &Report, model: Option<&Model<'_>>, port: &Path) -> Result<()> {
    match (report, model) {
        (Report::Hello { model_hash, .. }, Some(model))
            if !model.manifest().provenance.config_hash.starts_with(model_hash) =>
        {
            let remedy = "give --model the blob that was flashed, or --load this one";
            let value = format!("{model_hash:02x?}");
            Err(Error::bad_input(port, "model", value, "that of --model", remedy))
        }
        _ => Ok(()),
    }
}

struct Stage<Port> {
    session: Session<Port>,
    start: Instant,
    outcome: Outcome,
}

impl<Port: Read + Write> Stage<Port> {
    /// Has the body play from another blob.
    fn load(&mut self, path: &Path, blob: &[u8]) -> Result<()> {
        let style =
            ProgressStyle::with_template("loading {wide_bar} {bytes}/{total_bytes}, {eta} left")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(blob.len() as u64).with_style(style);
        let answer = self.session.load(blob, |sent| bar.set_position(sent as u64));
        bar.finish_and_clear();
        answer?.map_err(|reason| {
            let remedy = match reason {
                Refusal::NotRelaxed => {
                    "tell the body `relax` where it lies safely, then load again"
                }
                Refusal::NotSupported => "flash the blob: this firmware takes none over the line",
                Refusal::BlobTooLarge => "`host-trainer quantize` a smaller one",
                Refusal::BadBlob => "quantise it for the firmware that the body has",
                _ => "load it again; the body keeps the blob of before",
            };
            let field = "the body's answer to the blob";
            Error::bad_input(path, field, format!("{reason:?}"), "that it takes it", remedy)
        })?;
        self.outcome.loaded_bytes = blob.len();
        eprintln!("{:8.2} s  loaded {} bytes", self.start.elapsed().as_secs_f64(), blob.len());
        Ok(())
    }

    /// Compares the body's model with the user's.
    fn greet(&mut self, model: Option<&Model<'_>>, port: &Path) -> Result<()> {
        let until = Instant::now() + Duration::from_millis(500);
        let mut is_greeted = false;
        while !is_greeted && Instant::now() < until {
            self.session.listen(until)?;
            while let Some(report) = self.session.take_report() {
                is_greeted |= matches!(report, Report::Hello { .. });
                compare(&report, model, port)?;
                self.tell(report);
            }
        }
        Ok(())
    }

    fn play(&mut self, cues: &[Cue]) -> Result<()> {
        for cue in cues {
            if let Some(at) = cue.at {
                self.listen_until(self.start + at)?;
            }
            if let Err(error) = self.give(&cue.command) {
                // Best effort: the error that brought us here is the one to report.
                let _ = self.session.command(&Command::SoftStop);
                return Err(error);
            }
        }
        self.listen_until(Instant::now() + LAST_WORDS)
    }

    /// Obeys what is typed; what is wrong or refused is said, and the next line is read.
    fn obey_terminal(&mut self, reader: &mut Reader<'_, '_>) -> Result<()> {
        for line in std::io::stdin().lock().lines() {
            let line = line.map_err(Error::io("read", "standard input"))?;
            match reader.read(&line) {
                Ok(None) => {}
                Err(Wrong { value, expected }) => eprintln!("{value}: expected {expected}"),
                Ok(Some(cue)) => match self.give(&cue.command) {
                    Err(error @ Error::Io { .. }) => return Err(error),
                    outcome => outcome.unwrap_or_else(|error| eprintln!("{error}")),
                },
            }
            self.listen_until(Instant::now() + 2 * READ_TIME)?;
        }
        Ok(())
    }

    fn give(&mut self, command: &Command<'_>) -> Result<()> {
        self.outcome.commands += 1;
        let answer = self.session.command(command)?;
        eprintln!("{:8.2} s  {command:?}", self.start.elapsed().as_secs_f64());
        answer.map_err(|reason| {
            self.outcome.refused += 1;
            self.session.refused(reason)
        })
    }

    fn listen_until(&mut self, until: Instant) -> Result<()> {
        while Instant::now() < until {
            self.session.listen(until)?;
            while let Some(report) = self.session.take_report() {
                self.tell(report);
            }
        }
        Ok(())
    }

    fn tell(&mut self, report: Report) {
        let seconds = self.start.elapsed().as_secs_f64();
        match report {
            Report::Telemetry { tick, interventions, broken_frames, pulses_us } => {
                let outcome = &mut self.outcome;
                (outcome.ticks, outcome.interventions) = (tick, interventions);
                outcome.broken_frames = broken_frames;
                outcome.pulses_us = pulses_us.to_vec();
            }
            Report::Fault { code } => {
                self.outcome.faults.push(code);
                let fault = karakuri::Fault::from_code(code);
                let words = fault.map_or_else(|| "unknown".into(), |fault| fault.to_string());
                eprintln!(
                    "{seconds:8.2} s  fault {code}: {words}; `clear-fault` lets the body go on"
                );
            }
            report => eprintln!("{seconds:8.2} s  {report:?}"),
        }
    }
}
