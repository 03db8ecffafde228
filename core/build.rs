//! Chooses the kernel family from the target, so that nobody has to know about it.
//!
//! In:  `TARGET`, and `-C target-cpu` in the compiler's flags (stable rustc does not show DSP or MVE as features).
//! Out: `cfg(karakuri_kernel = "…")`; `cfg(karakuri_rows)` where the family reads row after row; `cfg(karakuri_vfp)`
//!      where single-precision floats are in hardware.
//!
//! Every family computes the same bits, so a cautious guess costs speed and nothing else.

use std::env;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!(
        "cargo:rustc-check-cfg=cfg(karakuri_kernel, \
         values(\"portable\", \"vector\", \"armv6m\", \"armv7m\", \"dsp\"))"
    );
    println!("cargo:rustc-check-cfg=cfg(karakuri_vfp)");
    println!("cargo:rustc-check-cfg=cfg(karakuri_rows)");
    let target = env::var("TARGET").unwrap_or_default();
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let forced = env::var_os("CARGO_FEATURE_PORTABLE").is_some();
    // Flags come separated by 0x1F; `-dsp` takes from a named processor what it would have.
    let processor = if flags.contains("-dsp") { "" } else { processor(&flags) };
    let family = if forced { "portable" } else { family(&target, processor) };
    println!("cargo:rustc-cfg=karakuri_kernel=\"{family}\"");
    if matches!(family, "portable" | "vector") {
        println!("cargo:rustc-cfg=karakuri_rows");
    }
    // Every hard-float Cortex-M has at least single precision, with VMLA and conversions from binary16.
    if !forced && target.starts_with("thumb") && target.ends_with("eabihf") {
        println!("cargo:rustc-cfg=karakuri_vfp");
    }
}

/// The last `target-cpu` wins, as for rustc.
fn processor(flags: &str) -> &str {
    let last = flags.split('\x1f').rfind(|flag| flag.contains("target-cpu="));
    last.and_then(|flag| flag.rsplit_once('=')).map_or("", |(_, name)| name)
}

/// Armv8-M mainline may lack the DSP extension: only a named processor is known to have it.
fn family(target: &str, processor: &str) -> &'static str {
    let architecture = target.split('-').next().unwrap_or_default();
    match (architecture, processor) {
        ("thumbv8m.main", "cortex-m55" | "cortex-m85" | "cortex-m52") => "vector",
        ("thumbv8m.main", "cortex-m33" | "cortex-m35p") => "dsp",
        ("thumbv7em", _) => "dsp",
        ("thumbv7m" | "thumbv8m.main", _) => "armv7m",
        ("thumbv6m" | "thumbv8m.base", _) => "armv6m",
        _ => "portable",
    }
}
