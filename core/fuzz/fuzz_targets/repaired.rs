#![no_main]
//! Damaged blobs whose length and checksum fit, as a forger or a faulty tool would write them.

#[path = "../src/hostile.rs"]
mod hostile;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| hostile::load_repaired(bytes));
