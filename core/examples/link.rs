//! What the linker is told: where the memory is described, and by which scripts. The build script of every example.

use std::env;

fn main() {
    let package = env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    println!("cargo::rustc-link-search={package}");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    if package.ends_with("rp2040") {
        println!("cargo::rustc-link-arg-bins=-Tlink-rp.x");
    }
    println!("cargo::rerun-if-changed=memory.x");
}
