//! Finds a cargo that can compile for a bare-metal target on this machine.
//!
//! In:  a [`Target`].
//! Out: [`Toolchain`], which makes the build command for `firmware.rs`.
//!
//! Why here: two kinds of machine are common. With rustup, `rustup target add` installs a ready-made library; that is
//! preferred. Where nothing can be downloaded from there, Debian's compiler builds the library from its packaged
//! source, which takes half a minute the first time.
//!
//! Source: the cargo book, "build-std"; Debian's packages rustc-web, cargo-web and rust-web-src.

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::{Error, Result};
use crate::target::Target;

/// Variables by which a cargo that runs us would bend the cargo that we run.
const INHERITED: [&str; 9] = [
    "CARGO",
    "CARGO_BUILD_TARGET",
    "CARGO_ENCODED_RUSTFLAGS",
    "RUSTC",
    "RUSTC_WORKSPACE_WRAPPER",
    "RUSTC_WRAPPER",
    "RUSTDOC",
    "RUSTFLAGS",
    "RUSTUP_TOOLCHAIN",
];

/// Linker of the toolchains that bring none for bare metal along.
const GNU_LINKER: &str = "arm-none-eabi-ld";

/// A cargo, its rustc, and how they get at `core` and at a linker for one target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Toolchain {
    target: Target,
    cargo: PathBuf,
    rustc: PathBuf,
    library: Library,
    linker: Linker,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Library {
    /// Installed for the target.
    Installed,
    /// Compiled from source by `-Zbuild-std`.
    FromSource,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Linker {
    /// The toolchain's own LLD, rustc's default for these targets.
    Lld,
    /// GNU ld of the Arm toolchain.
    Gnu,
}

impl Toolchain {
    /// Looks at the toolchain on the `PATH`, then at the system's own in `/usr/bin`.
    ///
    /// An installed target is preferred to one built from source. Toolchains are asked in `folder`, because rustup
    /// chooses by folder.
    ///
    /// # Errors
    /// [`Error::MissingTool`] with both ways to install one.
    pub fn find(target: Target, folder: &Path) -> Result<Self> {
        let candidates: Vec<Self> = ["", "/usr/bin"]
            .iter()
            .filter_map(|bin| Self::probe(target, Path::new(bin), folder))
            .collect();
        candidates
            .iter()
            .find(|found| found.library == Library::Installed)
            .or_else(|| candidates.first())
            .cloned()
            .ok_or_else(|| missing(target))
    }

    /// The toolchain whose programs are in `bin` (empty: on the `PATH`), if it can serve.
    fn probe(target: Target, bin: &Path, folder: &Path) -> Option<Self> {
        let (cargo, rustc) = (bin.join("cargo"), bin.join("rustc"));
        answer(clean_command(&cargo).arg("--version").current_dir(folder))?;
        let sysroot =
            answer(clean_command(&rustc).args(["--print", "sysroot"]).current_dir(folder))?;
        let rustlib = Path::new(&sysroot).join("lib/rustlib");
        let library = if rustlib.join(target.triple()).join("lib").is_dir() {
            Library::Installed
        } else if rustlib.join("src/rust/library/core/Cargo.toml").is_file() {
            Library::FromSource
        } else {
            return None;
        };
        let linker = if has_lld(&rustlib) {
            Linker::Lld
        } else {
            answer(Command::new(GNU_LINKER).arg("--version"))?;
            Linker::Gnu
        };
        Some(Self { target, cargo, rustc, library, linker })
    }

    /// What the compiler says about its version.
    ///
    /// # Errors
    /// [`Error::MissingTool`] if it has gone.
    pub fn compiler(&self, folder: &Path) -> Result<String> {
        answer(clean_command(&self.rustc).arg("--version").current_dir(folder))
            .ok_or_else(|| missing(self.target))
    }

    /// `cargo build --release` for the target, to be completed with the program's own arguments.
    pub fn build_command(&self) -> Command {
        let mut command = clean_command(&self.cargo);
        command.args(["build", "--release", "--locked", "--target", self.target.triple()]);
        if self.rustc.is_absolute() {
            command.env("RUSTC", &self.rustc);
        }
        let mut flags = vec!["-C".to_owned(), format!("target-cpu={}", self.target.name())];
        flags.extend(remapped_paths());
        if self.linker == Linker::Gnu {
            flags.extend(["-C".to_owned(), "linker-flavor=ld".to_owned()]);
            command.arg("--config").arg(setting("linker", &format!("{GNU_LINKER:?}")));
        }
        command.arg("--config").arg(setting("rustflags", &format!("{flags:?}")));
        if self.target == Target::CortexM55 {
            // The vectoriser works at this level only, and for the whole program.
            command.args(["--config", "profile.release.opt-level=3"]);
        }
        if self.library == Library::FromSource {
            command.arg("-Zbuild-std=core").env("RUSTC_BOOTSTRAP", "1");
        }
        command
    }
}

/// Panics carry the paths of sources; without the part that differs, every machine makes the same program.
fn remapped_paths() -> impl Iterator<Item = String> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_owned);
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(env::home_dir()?.join(".cargo")));
    let pairs = [(repository, "karakuri"), (home, "cargo")];
    let named = pairs.into_iter().filter_map(|(path, name)| Some((path?, name)));
    named.map(|(path, name)| format!("--remap-path-prefix={}={name}", path.display()))
}

/// A setting for every bare-metal target: cargo does not find a key with a dot, which Armv8-M's triple has.
///
/// Cargo joins lists of all sources, so the linker script named in `.cargo/config.toml` stays.
fn setting(key: &str, toml: &str) -> OsString {
    format!("target.'cfg(target_os = \"none\")'.{key}={toml}").into()
}

fn missing(target: Target) -> Error {
    let triple = target.triple();
    Error::MissingTool {
        what: format!("a Rust toolchain for {triple}"),
        remedy: format!(
            "run `rustup target add {triple}`, or on Debian and Ubuntu `apt-get install -y \
             rustc-web cargo-web rust-web-src gcc-arm-none-eabi`"
        ),
    }
}

/// A command without the variables that a parent cargo or rustup set for itself.
fn clean_command(program: &Path) -> Command {
    let mut command = Command::new(program);
    for name in INHERITED {
        command.env_remove(name);
    }
    command
}

/// The first line that a program prints, if it exists and succeeds.
fn answer(command: &mut Command) -> Option<String> {
    let output = command.output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?;
    text.lines().next().map(str::to_owned)
}

/// Whether the toolchain with this `lib/rustlib` folder has LLD for any host.
fn has_lld(rustlib: &Path) -> bool {
    let Ok(folders) = rustlib.read_dir() else {
        return false;
    };
    folders.flatten().any(|folder| folder.path().join("bin/rust-lld").is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_without_programs_holds_no_toolchain() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Toolchain::probe(Target::CortexM4, folder.path(), folder.path()), None);
    }

    #[test]
    fn missing_toolchain_names_both_ways_to_get_one() {
        let text = missing(Target::CortexM4).to_string();
        assert!(text.contains("rustup target add thumbv7em-none-eabihf"), "{text}");
        assert!(text.contains("apt-get install -y rustc-web"), "{text}");
    }

    #[test]
    fn build_from_source_passes_linker_and_processor() {
        let toolchain = Toolchain {
            target: Target::CortexM4,
            cargo: "/usr/bin/cargo".into(),
            rustc: "/usr/bin/rustc".into(),
            library: Library::FromSource,
            linker: Linker::Gnu,
        };
        let command = toolchain.build_command();
        let arguments: Vec<_> = command.get_args().map(|text| text.to_string_lossy()).collect();
        let expected = [
            r#"target.'cfg(target_os = "none")'.linker="arm-none-eabi-ld""#,
            r#"target.'cfg(target_os = "none")'.rustflags=["-C", "target-cpu=cortex-m4", "#,
            r#""-C", "linker-flavor=ld"]"#,
            "-Zbuild-std=core",
        ];
        for argument in expected {
            assert!(arguments.iter().any(|found| found.contains(argument)), "{arguments:?}");
        }
    }
}
