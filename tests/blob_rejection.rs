//! A damaged blob never becomes a motion: whatever happens to its bytes, loading ends in an error with a name.
//!
//! Why here: flash wears, downloads break, linkers place bytes anywhere. `core` has unit tests on a model of a few
//! bytes; this is a real one.

use std::ops::Range;
use std::thread;

use karakuri::blob::{HEADER_BYTES, VERSION, VERSION_OLDEST};
use karakuri::limits::WIDTH_MAX;
use karakuri::{ActionId, BlobError, Decoder, FramePosition, Model, Pcg32, Pose, Workspace};
use tests::{CHECKSUM_FIELD, FORMATS, golden_blob, seal};

const VERSION_FIELD: Range<usize> = 4..6;
const LENGTH_FIELD: Range<usize> = 8..12;
const DESCRIPTIONS_LENGTH_FIELD: Range<usize> = 16..20;

/// Changes of one byte: lowest bit, highest bit, all bits.
const CHANGES: [u8; 3] = [0x01, 0x80, 0xff];

/// Loads the blob and, if it loads, samples and decodes every action: none of it may panic.
fn survives(blob: &[u8], workspace: &mut Workspace<WIDTH_MAX>) -> Result<(), BlobError> {
    let model = Model::from_bytes(blob)?;
    let mut decoder = Decoder::new(&model, workspace)?;
    let mut rng = Pcg32::new(1);
    let mut pose = Pose::new();
    for action in (0..model.manifest().action_count).map(ActionId) {
        let frames = *model.trained_frames(action).end();
        // An action without a length is a refusal, too.
        let Ok(code) = model.sample(action, frames, &mut || rng.next_u32()) else { continue };
        decoder.start(&code);
        decoder.decode(FramePosition::from_bits(frames << 15), &mut pose);
        assert_eq!(pose.channels().len(), model.channel_count());
    }
    Ok(())
}

/// Calls `check` with every place, spread over the cores of this machine.
fn for_each_place(places: impl Iterator<Item = usize>, check: impl Fn(usize) + Sync) {
    let places: Vec<usize> = places.collect();
    let thread_count = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for part in places.chunks(places.len().div_ceil(thread_count).max(1)) {
            scope.spawn(|| part.iter().for_each(|&place| check(place)));
        }
    });
}

#[test]
fn our_checksum_is_the_blobs() {
    for format in FORMATS {
        let (blob, mut sealed) = (golden_blob(format), golden_blob(format));
        seal(&mut sealed);
        assert!(blob == sealed, "{format}");
    }
}

#[test]
fn blob_cut_at_any_length_is_rejected_by_its_length() {
    for format in FORMATS {
        let blob = golden_blob(format);
        for len in 0..blob.len() {
            let error = Model::from_bytes(&blob[..len]).expect_err("a cut blob");
            assert!(
                matches!(error, BlobError::WrongLength { found, .. } if found == len),
                "{format}, {len}: {error}"
            );
        }
    }
}

#[test]
fn blob_with_bytes_after_its_end_is_rejected_by_its_length() {
    for format in FORMATS {
        let mut blob = golden_blob(format);
        let expected = blob.len();
        for found in expected + 1..expected + 40 {
            blob.push(0xff);
            assert_eq!(
                Model::from_bytes(&blob).err(),
                Some(BlobError::WrongLength { found, expected })
            );
        }
    }
}

/// Every byte of the w8a16 blob with all bits flipped; the other formats share the envelope, so every 16th of theirs.
#[test]
fn blob_with_any_byte_changed_is_rejected() {
    for format in FORMATS {
        let blob = golden_blob(format);
        let stride = if format == FORMATS[0] { 1 } else { 16 };
        for_each_place((0..blob.len()).step_by(stride), |place| {
            let mut changed = blob.clone();
            changed[place] ^= 0xff;
            let error = Model::from_bytes(&changed).expect_err("a changed blob");
            let is_named = match error {
                BlobError::WrongMagic => place < VERSION_FIELD.start,
                BlobError::NewerVersion { .. } => VERSION_FIELD.contains(&place),
                BlobError::WrongLength { .. } => LENGTH_FIELD.contains(&place),
                BlobError::WrongChecksum { .. } => {
                    place >= VERSION_FIELD.end && !LENGTH_FIELD.contains(&place)
                }
                _ => false,
            };
            assert!(is_named, "{format}, byte {place}: {error}");
        });
    }
}

/// A single bit is the least that a checksum has to notice.
#[test]
fn blob_with_a_single_bit_flipped_is_rejected() {
    for format in FORMATS {
        let blob = golden_blob(format);
        for_each_place((HEADER_BYTES..blob.len()).step_by(37), |place| {
            let mut changed = blob.clone();
            changed[place] ^= 1 << (place % 8);
            let error = Model::from_bytes(&changed).expect_err("a changed blob");
            assert!(
                matches!(error, BlobError::WrongChecksum { .. }),
                "{format}, byte {place}: {error}"
            );
        });
    }
}

#[test]
fn blob_of_a_newer_version_is_rejected_by_its_version() {
    for format in FORMATS {
        for found in [VERSION + 1, VERSION + 7, u16::MAX] {
            let mut blob = golden_blob(format);
            blob[VERSION_FIELD].copy_from_slice(&found.to_le_bytes());
            // The version is looked at before the checksum: a newer one may be computed otherwise.
            for _ in 0..2 {
                let newer = BlobError::NewerVersion { found, newest: VERSION };
                assert_eq!(Model::from_bytes(&blob).err(), Some(newer));
                seal(&mut blob);
            }
        }
    }
}

#[test]
fn blob_of_an_older_version_is_rejected_by_its_version() {
    for format in FORMATS {
        for found in 0..VERSION_OLDEST {
            let mut blob = golden_blob(format);
            blob[VERSION_FIELD].copy_from_slice(&found.to_le_bytes());
            seal(&mut blob);
            let older = BlobError::OlderVersion { found, oldest: VERSION_OLDEST };
            assert_eq!(Model::from_bytes(&blob).err(), Some(older));
        }
    }
}

/// Header and descriptions decide what is read where: every byte of them, three changes each, with a checksum that
/// fits.
#[test]
fn forged_descriptions_are_rejected_or_harmless() {
    for format in FORMATS {
        let blob = golden_blob(format);
        let descriptions: [u8; 4] = blob[DESCRIPTIONS_LENGTH_FIELD].try_into().expect("four bytes");
        let end = HEADER_BYTES + u32::from_le_bytes(descriptions) as usize;
        for_each_place((0..end).filter(|place| !CHECKSUM_FIELD.contains(place)), |place| {
            let mut workspace = Box::<Workspace<WIDTH_MAX>>::default();
            for change in CHANGES {
                let mut forged = blob.clone();
                forged[place] ^= change;
                seal(&mut forged);
                let outcome = survives(&forged, &mut workspace);
                assert!(
                    place >= HEADER_BYTES || outcome.is_err(),
                    "{format}, byte {place} of the header"
                );
            }
        });
    }
}

/// Weights, scales, codes and intervals with a checksum that fits: every 101st byte, and all of the first kibibyte,
/// where the sampler's tables are.
#[test]
fn forged_tensors_are_rejected_or_harmless() {
    const STRIDE: usize = 101;
    const TABLE_BYTES: usize = 1024;
    for format in FORMATS {
        let blob = golden_blob(format);
        let descriptions: [u8; 4] = blob[DESCRIPTIONS_LENGTH_FIELD].try_into().expect("four bytes");
        let start = HEADER_BYTES + u32::from_le_bytes(descriptions) as usize;
        let sparse = (start + TABLE_BYTES..blob.len()).step_by(STRIDE);
        for_each_place((start..start + TABLE_BYTES).chain(sparse), |place| {
            let mut workspace = Box::<Workspace<WIDTH_MAX>>::default();
            let mut forged = blob.clone();
            forged[place] ^= CHANGES[place % CHANGES.len()];
            seal(&mut forged);
            // Either is fine; `survives` itself fails the test if anything panics.
            let _ = survives(&forged, &mut workspace);
        });
    }
}

#[test]
fn blob_gives_the_same_pose_at_any_alignment() {
    #[repr(align(64))]
    struct Aligned([u8; 128 * 1024]);

    for format in FORMATS {
        let blob = golden_blob(format);
        let mut memory = Box::new(Aligned([0; 128 * 1024]));
        let mut poses = Vec::new();
        for offset in 0..=64 {
            let place = &mut memory.0[offset..offset + blob.len()];
            place.copy_from_slice(&blob);
            let model = Model::from_bytes(place).expect("any alignment will do");
            let mut workspace = Box::<Workspace<WIDTH_MAX>>::default();
            let mut decoder = Decoder::new(&model, &mut workspace).expect("the widest workspace");
            let (mut rng, mut pose) = (Pcg32::new(3), Pose::new());
            let frames = *model.trained_frames(ActionId(0)).start();
            decoder.start(
                &model
                    .sample(ActionId(0), frames, &mut || rng.next_u32())
                    .expect("a trained length"),
            );
            decoder.decode(FramePosition::from_frames(9), &mut pose);
            poses.push(pose);
        }
        assert!(poses.windows(2).all(|pair| pair[0] == pair[1]), "{format}");
    }
}
