//! The image that a product would flash holds no panic, no heap, no floats where integers were promised, and is small.
//!
//! In:  `minimal`, linked for chips with and without floating point, at both common optimisation levels.
//! Out: its symbol table, read here.
//!
//! Why here: the source cannot be asked; only the linker knows which panics of which dependency are still reachable.
//! Source: Run-time ABI for the Arm Architecture (AAELF's helper names), sections 5.1.2 and 5.1.3.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use firmware_sim::Target;
use firmware_sim::toolchain::Toolchain;
use object::{Object, ObjectSection, ObjectSymbol};
use tests::{repository, skip};

/// Parts of names, as the compiler mangles them, that stand for the end of a program.
const PANICS: [&str; 6] =
    ["rust_begin_unwind", "panic", "unwrap_failed", "expect_failed", "_fail", "unwrap_in_const"];
/// Parts of names of anything that allocates.
const HEAP: [&str; 4] = ["__rust_alloc", "__rust_realloc", "malloc", "5alloc"];
/// Beginnings of the Arm run-time's names for soft floats; `compiler_builtins` and `libm` are where Rust keeps them.
const FLOATS: [&str; 5] = ["__aeabi_f", "__aeabi_d", "__aeabi_cf", "__aeabi_cd", "__aeabi_h2f"];

/// What of `minimal` is built, and how.
#[derive(Clone, Copy, Debug)]
struct Build {
    target: Target,
    optimisation: &'static str,
    /// Feature and seed of this name.
    format: &'static str,
    /// Bytes of code and constants, the blob left out: as measured, up to the next KiB. A larger image fails.
    code_kib_max: u64,
}

/// One number format an image, as a product has it; the smallest, and level 3, where inlining could bring a panic back.
const INTEGER: [Build; 5] = [
    Build { target: Target::CortexM0Plus, optimisation: "'s'", format: "w8a8", code_kib_max: 23 },
    Build { target: Target::CortexM0Plus, optimisation: "'s'", format: "w4a8", code_kib_max: 24 },
    Build { target: Target::CortexM4, optimisation: "'s'", format: "w8a16", code_kib_max: 20 },
    Build { target: Target::CortexM4, optimisation: "3", format: "w4a8", code_kib_max: 34 },
    Build { target: Target::CortexM4, optimisation: "'s'", format: "w8a8", code_kib_max: 21 },
];
const F16: Build =
    Build { target: Target::CortexM4, optimisation: "3", format: "f16", code_kib_max: 36 };

/// A linked program.
struct Image {
    symbols: BTreeSet<String>,
    /// Code and constants without the blob.
    code_bytes: u64,
}

impl Image {
    /// `None`, said aloud, where no compiler for the target is installed.
    fn of(build: Build, more_features: &str) -> Option<Self> {
        // One at a time: the builds of a target replace each other's output.
        static CARGO: Mutex<()> = Mutex::new(());
        let _turn = CARGO.lock().unwrap_or_else(PoisonError::into_inner);
        let source = repository().join("firmware-sim/cortex-m");
        let toolchain = match Toolchain::find(build.target, &source) {
            Ok(toolchain) => toolchain,
            Err(error) => {
                skip(&error.to_string());
                return None;
            }
        };
        let blob = repository().join(format!("core/fuzz/seeds/{}-clips.kara", build.format));
        let features = format!("{} {more_features}", build.format);
        let elf = link(toolchain.build_command(), build, &features, &blob);
        let bytes = fs::read(elf).expect("the program that was just linked");
        Some(Self::read(&bytes))
    }

    fn read(bytes: &[u8]) -> Self {
        let file = object::File::parse(bytes).expect("an ELF file");
        let names = file.symbols().filter_map(|symbol| symbol.name().ok().map(str::to_owned));
        let symbols: BTreeSet<String> = names.collect();
        assert!(symbols.contains("Reset"), "stripped of its symbols, an image proves nothing");
        let size = |name| file.section_by_name(name).map_or(0, |section| section.size());
        Self { symbols, code_bytes: size(".text") + size(".rodata") }
    }

    fn symbols(&self, is_meant: impl Fn(&str) -> bool) -> Vec<&str> {
        self.symbols.iter().map(String::as_str).filter(|name| is_meant(name)).collect()
    }

    fn panics(&self) -> Vec<&str> {
        self.symbols(|name| PANICS.iter().any(|part| name.contains(part)))
    }

    fn heap(&self) -> Vec<&str> {
        self.symbols(|name| HEAP.iter().any(|part| name.contains(part)))
    }

    fn floats(&self) -> Vec<&str> {
        self.symbols(is_soft_float)
    }

    /// Other routines of the Arm run-time: 64-bit and division helpers, copies.
    fn runtime(&self) -> Vec<&str> {
        self.symbols(|name| name.starts_with("__aeabi_") && !is_soft_float(name))
    }
}

/// Whether a name is a float routine of the Arm run-time, of the compiler's (`__addsf3`, `__floatsidf`), or of libm.
fn is_soft_float(name: &str) -> bool {
    let converts_to_float = name.starts_with("__aeabi_")
        && (name.ends_with("2f") || name.ends_with("2d") || name.ends_with("2h"));
    let of_the_compiler = name.starts_with("__")
        && !name.starts_with("__aeabi_")
        && ["sf", "df", "hf"].iter().any(|kind| name.contains(kind));
    let of_a_library = ["17compiler_builtins5float", "17compiler_builtins4math", "4libm"]
        .iter()
        .any(|path| name.contains(path));
    FLOATS.iter().any(|start| name.starts_with(start))
        || converts_to_float
        || of_the_compiler
        || of_a_library
}

/// Builds `minimal` and returns its path.
fn link(mut cargo: Command, build: Build, features: &str, blob: &Path) -> PathBuf {
    let folder = repository().join("target/firmware/image").join(build.target.name());
    let width = karakuri::Model::from_bytes(&fs::read(blob).expect("a committed blob"))
        .map(|model| model.workspace_width())
        .expect("a blob that loads");
    let output = cargo
        .args(["--bin", "minimal", "--no-default-features", "--features", features])
        .args(["--config", &format!("profile.release.opt-level={}", build.optimisation)])
        .args([
            "--config",
            &format!("profile.release.package.karakuri.opt-level={}", build.optimisation),
        ])
        .arg("--target-dir")
        .arg(&folder)
        .env("KARAKURI_WIDTH", width.to_string())
        .env("KARAKURI_MEMORY", build.target.memory_map())
        .current_dir(repository().join("firmware-sim/cortex-m"))
        .output()
        .expect("cargo starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    folder.join(build.target.triple()).join("release/minimal")
}

/// A test that cannot fail proves nothing: `forbidden` adds a slice index, a float and nothing else.
#[test]
fn image_with_a_deliberate_panic_and_a_float_is_found_out() {
    let Some(image) = Image::of(INTEGER[0], "forbidden") else { return };
    let panics = image.panics();
    for part in ["rust_begin_unwind", "panic_fmt"] {
        assert!(panics.iter().any(|name| name.contains(part)), "{part} is not in {panics:?}");
    }
    let floats = image.floats();
    for name in ["__aeabi_fmul", "__aeabi_ui2f"] {
        assert!(floats.contains(&name), "{name} is not in {floats:?}");
    }
}

#[test]
fn names_of_soft_floats_are_told_from_those_of_integers() {
    for name in ["__aeabi_fadd", "__aeabi_d2iz", "__aeabi_l2f", "__mulsf3", "__floatundidf"] {
        assert!(is_soft_float(name), "{name}");
    }
    for name in ["__aeabi_lmul", "__aeabi_uidivmod", "__aeabi_memcpy4", "__clzsi2", "__udivmoddi4"]
    {
        assert!(!is_soft_float(name), "{name}");
    }
}

#[test]
fn no_image_of_a_product_can_panic() {
    for build in INTEGER.into_iter().chain([F16]) {
        let Some(image) = Image::of(build, "") else { return };
        let panics = image.panics();
        assert!(panics.is_empty(), "{build:?}: {panics:#?}");
    }
}

#[test]
fn integer_images_call_no_float_routine_and_no_allocator() {
    for build in INTEGER {
        let Some(image) = Image::of(build, "") else { return };
        println!("{build:?}: run-time routines {:?}", image.runtime());
        assert_eq!(image.floats(), [""; 0], "{build:?}");
        assert_eq!(image.heap(), [""; 0], "{build:?}");
    }
}

#[test]
fn code_of_an_image_does_not_grow() {
    for build in INTEGER.into_iter().chain([F16]) {
        let Some(image) = Image::of(build, "") else { return };
        println!("{build:?}: {} bytes", image.code_bytes);
        let kib = image.code_bytes.div_ceil(1024);
        assert!(kib <= build.code_kib_max, "{build:?}: {} bytes", image.code_bytes);
    }
}
