//! The loops chosen for a processor compute what the portable ones do, bit for bit, on every emulated processor.
//!
//! Why here: parity runs decode a few blobs; an error in an unrolled loop may need a length or a sum that none of them
//! has. `firmware-sim/cortex-m/src/bin/check_kernels.rs` tries thousands, here is only who runs it.

use std::path::PathBuf;
use std::time::Duration;

use firmware_sim::error::Error;
use firmware_sim::qemu::{self, Qemu};
use firmware_sim::target::Target;
use firmware_sim::toolchain::Toolchain;
use tests::{repository, skip};

const PROGRAM: &str = "check_kernels";

/// A run takes seconds and prints at its end.
const QEMU: Qemu = Qemu { program: qemu::PROGRAM, silence_max: Duration::from_secs(120) };

/// The kernels that the program must report on.
const KERNELS: [&str; 6] = ["w8a16", "w8a16_pair", "w8a8", "w8a8_pair", "w4a8", "f16"];

/// The family that `core/build.rs` is expected to choose.
const fn family(target: Target) -> &'static str {
    match target {
        Target::CortexM0Plus => "armv6m",
        Target::CortexM3 => "armv7m",
        Target::CortexM4 | Target::CortexM7 | Target::CortexM33 => "dsp",
        Target::CortexM55 => "vector",
    }
}

/// The compiled program.
fn build(target: Target) -> Result<PathBuf, Error> {
    let source = repository().join("firmware-sim/cortex-m");
    let folder = repository().join("target/firmware").join(target.name());
    let output = Toolchain::find(target, &source)?
        .build_command()
        .args(["--bin", PROGRAM, "--target-dir"])
        .arg(&folder)
        .env("KARAKURI_MEMORY", target.memory_map())
        .env("KARAKURI_WIDTH", "1")
        .current_dir(source)
        .output()
        .expect("the cargo that was found");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(folder.join(target.triple()).join("release").join(PROGRAM))
}

fn run(target: Target) -> Result<Vec<String>, Error> {
    QEMU.check_installed()?;
    let elf = build(target)?;
    let mut lines = Vec::new();
    QEMU.run(&elf, target, |line| lines.push(line.to_owned()))?;
    Ok(lines)
}

#[track_caller]
fn assert_every_kernel_matches(target: Target, lines: &[String]) {
    let answer = format!("{}:\n{}", target.name(), lines.join("\n"));
    println!("{answer}");
    assert_eq!(lines[0], format!("family {}", family(target)), "{answer}");
    assert_eq!(lines.len(), 1 + KERNELS.len(), "{answer}");
    for (line, kernel) in lines[1..].iter().zip(KERNELS) {
        let words: Vec<&str> = line.split(' ').collect();
        let ["cases", cases, "mismatches", mismatches] = words[1..] else { panic!("{answer}") };
        assert_eq!(words[0], kernel, "{answer}");
        assert!(cases.parse::<u32>().is_ok_and(|count| count > 5_000), "{answer}");
        assert_eq!(mismatches, "0", "{answer}");
    }
}

#[test]
fn every_assembly_kernel_equals_portable_rust() {
    for target in Target::ALL {
        match run(target) {
            Ok(lines) => assert_every_kernel_matches(target, &lines),
            Err(error @ Error::MissingTool { .. }) => skip(&error.to_string()),
            Err(error) => panic!("{}: {error}", target.name()),
        }
    }
}
