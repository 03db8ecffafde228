//! A host tells a body what to do, over a pseudo-terminal: the link from end to end, with both programs as users have
//! them.

#![cfg(unix)]

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use host_trainer::perform::session::Session;
use karakuri::link::{self, Mode, Play, Refusal, Report, blob_crc};
use tests::{golden_path, repository, sandbox};

const SCRIPT: &str = "\
0   wake
0   idle none
0.1 play nod 2 seed 7 over 300
0.4 query
0.6 hold
0.6 query
0.7 resume
0.7 dial rate 1.5
0.8 then shake 2
0.9 relax
";

/// A body that ends with the test.
struct Body {
    program: Child,
    port: PathBuf,
}

impl Body {
    fn serve(model: &Path) -> Self {
        let mut program = Command::new(env!("CARGO_BIN_EXE_firmware-sim-under-test"))
            .args(["serve", "--pty", "--minutes", "2"])
            .arg(model)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program was built for this test");
        let mut line = String::new();
        let stdout = program.stdout.as_mut().expect("it was asked for");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        Self { program, port: line.trim().into() }
    }
}

impl Drop for Body {
    fn drop(&mut self) {
        // Best effort: it ends by itself after two minutes.
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

fn perform(port: &Path, model: &Path, script: &str) -> Output {
    perform_with("--model", port, model, script)
}

/// `option`: what to do with the blob, `--model` or `--load`.
fn perform_with(option: &str, port: &Path, model: &Path, script: &str) -> Output {
    let folder = sandbox();
    let file = folder.path().join("script.txt");
    fs::write(&file, script).expect("a writable folder");
    Command::new(env!("CARGO_BIN_EXE_host-trainer-under-test"))
        .args(["perform", "--json", "--serial"])
        .arg(port)
        .arg(option)
        .arg(model)
        .arg("--script")
        .arg(file)
        .output()
        .expect("the program was built for this test")
}

fn error(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn script_is_refused_before_the_port_is_opened() {
    let model = golden_path("creature-tiny-w8a16.kara");
    let output = perform(Path::new("/dev/no-such-port"), &model, "0 wake\n1 play fly 2\n");
    assert_eq!(output.status.code(), Some(3), "{}", error(&output));
    let says = ["script.txt", "line 2", "fly", "pour_tea", "--help"];
    assert!(says.iter().all(|word| error(&output).contains(word)), "{}", error(&output));
    let output = perform(Path::new("/dev/no-such-port"), &model, "0 wake\n");
    assert_eq!(output.status.code(), Some(4), "{}", error(&output));
    assert!(error(&output).contains("/dev/no-such-port"), "{}", error(&output));
}

#[test]
fn body_performs_a_script_over_a_noisy_line_and_refuses_what_it_cannot_do() {
    let model = golden_path("creature-tiny-w8a16.kara");
    let body = Body::serve(&model);
    let noise: Vec<u8> = (0..=255).collect();
    fs::write(&body.port, &noise).expect("a line that takes bytes");
    let output = perform(&body.port, &model, SCRIPT);
    assert!(output.status.success(), "{}", error(&output));
    let said = error(&output);
    for words in ["mode: Playing, action: Some(5)", "mode: Holding", "Wake"] {
        assert!(said.contains(words), "{words} is not in\n{said}");
    }
    let outcome: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&outcome["commands"], &outcome["refused"]), (&10.into(), &0.into()));
    assert_eq!(outcome["faults"], serde_json::json!([]));
    assert!(outcome["broken_frames"].as_u64() > Some(0), "the noise was noticed: {outcome}");
    assert!(outcome["ticks"].as_u64() > Some(20), "{outcome}");
    let pulses_us = outcome["pulses_us"].as_array().expect("pulses");
    assert!(pulses_us.len() == 11 && pulses_us.iter().all(|pulse| *pulse == 0), "{outcome}");

    let output = perform(&body.port, &model, "play nod 2\n");
    assert_eq!(output.status.code(), Some(3), "released: {}", error(&output));
    assert!(error(&output).contains("Asleep"), "{}", error(&output));
    let output = perform(&body.port, &model, "wake\nplay nod 60\n");
    assert!(error(&output).contains("BadDuration"), "{}", error(&output));
}

/// A little model of another character than the golden ones: one servo, two actions.
fn small_blob() -> PathBuf {
    repository().join("core/fuzz/seeds/w8a16-clips.kara")
}

/// Noise on a line until it is dropped.
struct Noise<'a>(&'a AtomicBool);

impl Drop for Noise<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn body_takes_another_blob_over_a_noisy_line_and_plays_its_actions() {
    let (small, creature) = (small_blob(), golden_path("creature-tiny-w8a16.kara"));
    let body = Body::serve(&small);
    let awake = perform(&body.port, &small, "wake\n");
    assert!(awake.status.success(), "{}", error(&awake));
    let output = perform_with("--load", &body.port, &creature, "0 wake\n");
    assert_eq!(output.status.code(), Some(3), "{}", error(&output));
    let says = ["NotRelaxed", "relax", "creature-tiny-w8a16.kara"];
    assert!(says.iter().all(|word| error(&output).contains(word)), "{}", error(&output));
    let output = perform(&body.port, &small, "play nod 0.4\n0.2 relax\n");
    assert!(output.status.success(), "the old blob: {}", error(&output));

    let is_over = AtomicBool::new(false);
    let script = "0 wake\n0.1 play pour_tea 4\n0.3 query\n0.6 relax\n";
    let output = thread::scope(|scope| {
        let _noise = Noise(&is_over);
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                fs::write(&body.port, [3, 0, 7, 7, 0, 9]).expect("a line that takes bytes");
                thread::sleep(Duration::from_millis(20));
            }
        });
        perform_with("--load", &body.port, &creature, script)
    });
    assert!(output.status.success(), "{}", error(&output));
    assert!(error(&output).contains("mode: Playing, action: Some(6)"), "{}", error(&output));
    let outcome: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(outcome["loaded_bytes"], 32_768, "{outcome}");
    assert!(outcome["broken_frames"].as_u64() > Some(0), "the noise was noticed: {outcome}");
    assert_eq!(outcome["pulses_us"].as_array().map(Vec::len), Some(11), "{outcome}");
    let output = perform(&body.port, &small, "wake\n");
    assert!(error(&output).contains("--load"), "another model: {}", error(&output));
}

/// A port without settings: a pseudo-terminal has none that matter.
struct Port {
    file: File,
    heard: Receiver<u8>,
}

impl Port {
    fn open(path: &Path) -> Self {
        let file = File::options().read(true).write(true).open(path).expect("the body's line");
        let (sender, heard) = mpsc::channel();
        let reading = file.try_clone().expect("a second handle");
        // Ends with the body.
        thread::spawn(move || {
            BufReader::new(reading)
                .bytes()
                .map_while(Result::ok)
                .try_for_each(|byte| sender.send(byte))
        });
        Self { file, heard }
    }
}

impl Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let heard = self.heard.recv_timeout(Duration::from_millis(10));
        bytes[0] = heard.map_err(|_| ErrorKind::TimedOut)?;
        Ok(1)
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[test]
fn damaged_blob_is_refused_by_the_body_and_the_old_one_plays_on() {
    let creature = golden_path("creature-tiny-w8a16.kara");
    let body = Body::serve(&creature);
    let mut session = Session::open(Port::open(&body.port), &body.port).expect("a body");
    let mut blob = fs::read(small_blob()).expect("a seed of the fuzzer");
    let crc = blob_crc(&blob);
    let middle = blob.len() / 2;
    blob[middle] ^= 4;
    assert_eq!(session.load(&blob, |_| ()).expect("answers"), Err(Refusal::BadBlob));
    let mut say = |command| session.command(&command).expect("an answer");
    let len_bytes = blob.len() as u32;
    assert_eq!(say(link::Command::LoadBegin { len_bytes, crc }), Ok(()));
    let (first, last) = blob.split_at(200);
    let missing = |expected| Err(Refusal::WrongOffset { expected });
    assert_eq!(say(link::Command::LoadChunk { offset: 200, bytes: &last[..250] }), missing(0));
    assert_eq!(say(link::Command::LoadChunk { offset: 0, bytes: first }), Ok(()));
    assert_eq!(say(link::Command::LoadChunk { offset: 0, bytes: first }), missing(200), "twice");
    assert_eq!(say(link::Command::LoadCommit), missing(200));
    for (offset, bytes) in (200..).step_by(250).zip(last.chunks(250)) {
        assert_eq!(say(link::Command::LoadChunk { offset, bytes }), Ok(()));
    }
    assert_eq!(say(link::Command::LoadCommit), Err(Refusal::WrongChecksum));
    let huge = link::Command::LoadBegin { len_bytes: u32::MAX, crc };
    assert_eq!(say(huge), Err(Refusal::BlobTooLarge));

    assert_eq!(say(link::Command::Wake), Ok(()));
    let play = Play { action: 6, duration_ms: 4000, seed: 1, transition_ms: 300, then: false };
    assert_eq!(say(link::Command::Play(play)), Ok(()), "pour_tea, of the old blob");
    thread::sleep(Duration::from_millis(50));
    assert_eq!(say(link::Command::Query), Ok(()));
    let until = Instant::now() + Duration::from_secs(2);
    let playing = Report::State { mode: Mode::Playing, action: Some(6) };
    let mut reports = std::iter::from_fn(|| {
        session.listen(until).expect("a line");
        session.take_report()
    });
    assert!(reports.any(|report| report == playing));
}
