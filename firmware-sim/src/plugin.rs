//! Builds the instruction counter, a plugin of QEMU written in C.
//!
//! In:  `plugin/instruction_count.c`, and the version of the QEMU that will load it.
//! Out: a shared library for [`Extras::plugin`](crate::qemu::Extras::plugin).
//!
//! Why here: QEMU offers its counting hooks to C only, and loads no plugin made for another version of its interface.
//!
//! Source: `include/qemu/qemu-plugin.h` of QEMU: interface 1 before QEMU 9.0, at least 2 since, and another
//! `qemu_plugin_insn_data` from 3 on. Tried with QEMU 7.2 only.

use std::fs;
use std::io;
use std::path::Path;
use std::process::Command;

use crate::error::{Error, Result};
use crate::firmware::{build_folder, copy_away, lock};
use crate::qemu::Qemu;
use tempfile::TempPath;

/// The counter's source, as it was when this crate was compiled.
const SOURCE: &str = include_str!("../plugin/instruction_count.c");
/// The C compiler as packages install it.
const COMPILER: &str = "cc";

/// Compiles the counter for this QEMU, unless that was done before; the file lives as long as the result.
///
/// # Errors
/// [`Error::MissingTool`] without QEMU or a C compiler; [`Error::Build`] if it fails; [`Error::Io`].
pub fn build_plugin(qemu: Qemu<'_>) -> Result<TempPath> {
    let folder = build_folder("plugin")?;
    let _lock = lock(&folder)?;
    let source = folder.join("instruction_count.c");
    let interface = interface_of(&qemu.version()?);
    let library = folder.join(format!("instruction_count_{interface}.so"));
    if !(library.is_file() && fs::read_to_string(&source).is_ok_and(|stored| stored == SOURCE)) {
        fs::write(&source, SOURCE).map_err(Error::io("write", &source))?;
        compile(COMPILER, &source, &library, interface)?;
    }
    copy_away(&library)
}

fn compile(compiler: &str, source: &Path, library: &Path, interface: u32) -> Result<()> {
    let output = Command::new(compiler)
        .args(["-shared", "-fPIC", "-O2", &format!("-DPLUGIN_API={interface}"), "-o"])
        .args([library, source])
        .output()
        .map_err(|error| cannot_start(compiler, error))?;
    if output.status.success() {
        return Ok(());
    }
    let log = String::from_utf8_lossy(&output.stderr).into_owned();
    Err(Error::Build { target: "the plugin of QEMU", log })
}

fn cannot_start(compiler: &str, error: io::Error) -> Error {
    if error.kind() != io::ErrorKind::NotFound {
        return Error::io("start", compiler)(error);
    }
    Error::MissingTool {
        what: format!("a C compiler ({compiler})"),
        remedy: "on Debian and Ubuntu run `apt-get install -y gcc libc6-dev`".to_owned(),
    }
}

/// The interface that a QEMU with this answer to `--version` accepts; the oldest if it says nothing known.
fn interface_of(version: &str) -> u32 {
    let numbers = version.split("version ").nth(1).unwrap_or_default();
    let mut numbers = numbers.split(|c: char| !c.is_ascii_digit()).map_while(|n| n.parse().ok());
    let mut next = || -> u32 { numbers.next().unwrap_or(0) };
    match (next(), next()) {
        (0..9, _) => 1,
        (9, 0) => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_c_compiler_names_the_package_to_install() {
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join("x.so");
        let error = compile("cc-that-nobody-installed", folder.path(), &library, 1).unwrap_err();
        assert!(error.is_missing_tool());
        assert!(error.to_string().contains("apt-get install -y gcc libc6-dev"), "{error}");
    }

    #[test]
    fn interface_follows_the_version() {
        let answers = [
            ("QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7)\nCopyright", 1),
            ("QEMU emulator version 8.2.2 (Debian 1:8.2.2+ds-0ubuntu1)", 1),
            ("QEMU emulator version 9.0.1", 2),
            ("QEMU emulator version 10.0.2 (Debian 1:10.0.2+ds-2)", 3),
            ("something else", 1),
        ];
        for (answer, interface) in answers {
            assert_eq!(interface_of(answer), interface, "{answer}");
        }
    }
}
