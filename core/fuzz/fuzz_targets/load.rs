#![no_main]
//! Arbitrary bytes as a blob.

#[path = "../src/hostile.rs"]
#[allow(dead_code, reason = "the other target uses the rest")]
mod hostile;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| hostile::load(bytes));
