//! What the fuzzers found worth keeping, run once more on every change, by any compiler.
//!
//! In:  `core/fuzz/corpus`, minimised, and `core/fuzz/seeds`; `core/fuzz/README.md` says how they were made.
//!
//! Why here: the fuzzers themselves need a nightly compiler and hours.

#[path = "../core/fuzz/src/hostile.rs"]
mod hostile;

use tests::{contents, repository};

/// Calls `check` with every file of a folder of `core/fuzz`.
fn for_each_input(folder: &str, check: fn(&[u8])) {
    let inputs = contents(&repository().join("core/fuzz").join(folder));
    assert!(!inputs.is_empty(), "{folder} holds no inputs");
    for (name, bytes) in inputs {
        // The name stands in the captured output of the input that fails.
        println!("{}", name.display());
        check(&bytes);
    }
}

#[test]
fn bytes_of_the_corpus_load_or_are_refused() {
    for_each_input("corpus/load", hostile::load);
}

#[test]
fn repaired_blobs_of_the_corpus_load_or_are_refused() {
    for_each_input("corpus/repaired", hostile::load_repaired);
}

#[test]
fn seeds_load_as_they_are() {
    for (name, seed) in contents(&repository().join("core/fuzz/seeds")) {
        let outcome = karakuri::Model::from_bytes(&seed);
        assert!(outcome.is_ok(), "{}: {:?}", name.display(), outcome.err());
    }
}
