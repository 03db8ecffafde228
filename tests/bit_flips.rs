//! One flipped bit, the least that can happen to a blob: each of them, at every place.
//!
//! In:  the committed blobs, and the seeds of the fuzzers, which are smaller and hold every format, packing and table.
//!
//! Why here: flash loses single bits. Small blobs are loaded once for every bit. For the real ones that would read
//! 10 gigabytes; their checksum is followed bit by bit instead, and the loader is asked at some places whether it
//! agrees.
//! Source: CRCs are linear: a flip changes the checksum by a number that depends on nothing but the place of the bit.

// The fuzzers' own; the seal of a forger is the same.
#[path = "../core/fuzz/src/hostile.rs"]
mod hostile;

use karakuri::{BlobError, Model};
use tests::{CHECKSUM_FIELD, FORMATS, contents, golden_blob, repository};

fn seeds() -> Vec<Vec<u8>> {
    let seeds: Vec<_> = contents(&repository().join("core/fuzz/seeds")).into_values().collect();
    assert!(seeds.len() >= 14, "{} seeds", seeds.len());
    seeds
}

/// Calls `check` with every version of the blob in which one bit is flipped, and with the place of that bit.
fn for_each_flip(blob: &[u8], mut check: impl FnMut(&[u8], usize)) {
    let mut flipped = blob.to_vec();
    for place in 0..8 * blob.len() {
        flipped[place / 8] ^= 1 << (place % 8);
        check(&flipped, place);
        flipped[place / 8] ^= 1 << (place % 8);
    }
}

/// What each bit of a blob does to its checksum when it flips, by the place of the bit; 0 for the checksum's own.
fn checksum_changes(length: usize) -> Vec<u32> {
    let mut changes = vec![0; 8 * length];
    // A flip in the last bit of all is shifted through the register once, any other once more than its successor.
    let mut change = 0xedb8_8320;
    for place in (0..8 * length).rev() {
        if !CHECKSUM_FIELD.contains(&(place / 8)) {
            changes[place] = change;
            change = if change & 1 == 1 { change >> 1 ^ 0xedb8_8320 } else { change >> 1 };
        }
    }
    changes
}

fn stored_checksum(blob: &[u8]) -> u32 {
    u32::from_le_bytes(blob[CHECKSUM_FIELD].try_into().expect("four bytes"))
}

#[test]
fn any_flipped_bit_of_a_small_blob_is_a_named_error() {
    for seed in seeds() {
        for_each_flip(&seed, |flipped, place| {
            let error = Model::from_bytes(flipped).expect_err("a flipped bit");
            let is_named = match error {
                BlobError::WrongMagic => place < 8 * 4,
                BlobError::WrongLength { .. } => (8 * 8..8 * 12).contains(&place),
                // From the version on: one flip makes version 2 a version 3, which is known too.
                BlobError::WrongChecksum { .. } => place >= 8 * 4,
                _ => (8 * 4..8 * 6).contains(&place), // The version's.
            };
            assert!(is_named, "bit {place}: {error}");
        });
    }
}

/// The same with a checksum that fits, as a faulty writer would make it: an error, or a motion without a panic.
#[test]
fn any_flipped_bit_under_a_fitting_checksum_is_refused_or_harmless() {
    for seed in seeds() {
        for_each_flip(&seed, |flipped, _| hostile::load_repaired(flipped));
    }
}

#[test]
fn any_flipped_bit_of_a_real_blob_changes_its_checksum() {
    for format in FORMATS {
        let blob = golden_blob(format);
        let stored = stored_checksum(&blob);
        let changes = checksum_changes(blob.len());
        for (place, change) in changes.iter().enumerate() {
            let is_own = CHECKSUM_FIELD.contains(&(place / 8));
            assert!(is_own != (*change != 0), "{format}: a flip of bit {place} goes unnoticed");
        }
        for place in (8 * CHECKSUM_FIELD.end..8 * blob.len()).step_by(4099) {
            let mut flipped = blob.clone();
            flipped[place / 8] ^= 1 << (place % 8);
            let computed = stored ^ changes[place];
            let expected = BlobError::WrongChecksum { stored, computed };
            assert_eq!(Model::from_bytes(&flipped).err(), Some(expected), "{format}, bit {place}");
        }
    }
}
