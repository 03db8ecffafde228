//! A host tells a body what to do, over a pseudo-terminal: the link from end to end, with both programs as users have
//! them.

#![cfg(unix)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use tests::{golden_path, sandbox};

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
    let folder = sandbox();
    let file = folder.path().join("script.txt");
    fs::write(&file, script).expect("a writable folder");
    Command::new(env!("CARGO_BIN_EXE_host-trainer-under-test"))
        .args(["perform", "--json", "--serial"])
        .arg(port)
        .arg("--model")
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
