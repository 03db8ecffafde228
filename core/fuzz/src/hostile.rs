//! What is done to hostile bytes: load them and, if they load, use everything that a model offers.
//!
//! In:  any bytes.
//! Out: nothing; a broken promise is a panic.
//!
//! Why here: the fuzz targets and the test of the committed corpus (`tests/fuzz_corpus.rs`) are to do the same, so both
//! compile this file. Only public names are used: a new number format needs new seeds, not new code.

#[path = "checksum.rs"]
mod checksum;

use karakuri::limits::WIDTH_MAX;
use karakuri::{
    ActionId, BlobError, Code, Decoder, FramePosition, Model, PairDecoder, PairWorkspace, Pcg32,
    Pose, Workspace,
};

/// Where the header keeps the blob's length (`core/src/blob.rs`).
const LENGTH_FIELD: core::ops::Range<usize> = 8..12;
/// Larger blobs only slow the search for new ones down.
const REPAIRED_BYTES_MAX: usize = 1 << 16;
/// Workspaces for most inputs; wider models get the widest.
const WIDTH_SMALL: usize = 64;

/// Loads the bytes as they are, and plays what they hold.
pub fn load(bytes: &[u8]) {
    if let Ok(model) = Model::from_bytes(bytes) {
        use_everything(&model);
    }
}

/// Makes length and checksum fit first, so that what lies behind those checks is reached.
pub fn load_repaired(bytes: &[u8]) {
    let mut blob = bytes.to_vec();
    seal(&mut blob);
    // A changed manifest asks for other tensors: give it as many bytes as it wants, the old ones over and over.
    let refusal = Model::from_bytes(&blob).err();
    if let Some(BlobError::WrongLength { expected, .. }) = refusal
        && expected <= REPAIRED_BYTES_MAX
    {
        blob = bytes.iter().copied().cycle().take(expected).collect();
        seal(&mut blob);
    }
    load(&blob);
}

/// Writes length and checksum into the header, if there is one.
pub fn seal(blob: &mut [u8]) {
    let length = blob.len() as u32;
    if let Some(field) = blob.get_mut(LENGTH_FIELD) {
        field.copy_from_slice(&length.to_le_bytes());
    }
    if blob.len() >= checksum::CHECKSUM_FIELD.end {
        checksum::seal(blob);
    }
}

fn use_everything(model: &Model<'_>) {
    let channels: usize = model.groups().map(|group| group.kind.channel_count()).sum();
    assert_eq!(channels, model.channel_count());
    assert_eq!(model.joints().count(), usize::from(model.manifest().joint_count));
    assert_eq!(model.actions().count(), usize::from(model.manifest().action_count));
    for name in model.actions() {
        assert!(model.action_by_name(name).is_some());
    }
    let servos = karakuri::ServoStage::from_maps(model.servos());
    assert!(servos.is_ok(), "as many servos as a model may have");
    let _ = (model.multiply_accumulates_per_motion(), model.multiply_accumulates_per_pose());
    if model.workspace_width() <= WIDTH_SMALL {
        play(model, &mut Workspace::<WIDTH_SMALL>::new(), &mut PairWorkspace::new());
    } else {
        play(model, &mut Box::<Workspace<WIDTH_MAX>>::default(), &mut Box::default());
    }
}

fn play<const WIDTH: usize>(
    model: &Model<'_>,
    workspace: &mut Workspace<WIDTH>,
    pair_workspace: &mut PairWorkspace<WIDTH>,
) {
    let mut decoder = Decoder::new(model, workspace).expect("a model that loads can be decoded");
    // Only some packings have kernels for two frames.
    let mut pair_decoder = PairDecoder::new(model, pair_workspace).ok();
    let mut random = Pcg32::new(1);
    for action in (0..model.manifest().action_count).map(ActionId) {
        let trained = model.trained_frames(action);
        assert!(trained.start() <= trained.end());
        for frames in [*trained.start(), *trained.end()] {
            let drawn = model.sample(action, frames, &mut || random.next_u32());
            let code = drawn.expect("the ends of the trained lengths are trained lengths");
            assert_eq!(code.values().len(), model.code_count());
            let pose = decode(model, &mut decoder, &code, frames);
            if let Some(pair_decoder) = &mut pair_decoder {
                assert_eq!(pose, decode_pair(pair_decoder, &code, frames));
            }
        }
        // Any length may be asked for; most are refused.
        let _ = model.sample(action, random.next_u32() & 0xFFFF, &mut || random.next_u32());
    }
    let values: Vec<f32> = core::iter::repeat_n(1e9, model.code_count() + 1).collect();
    decode(model, &mut decoder, &model.code_from_f32(&values), 1);
}

/// Decodes a motion out of order; the same position must give the same pose whatever was decoded in between.
fn decode(model: &Model<'_>, decoder: &mut Decoder<'_, '_>, code: &Code, frames: u32) -> Pose {
    decoder.start(code);
    let (mut first, mut pose) = (Pose::new(), Pose::new());
    decoder.decode(middle(frames), &mut first);
    assert_eq!(first.channels().len(), model.channel_count());
    for position in
        [FramePosition::from_frames(1), FramePosition::from_bits(u32::MAX), middle(frames)]
    {
        decoder.decode(position, &mut pose);
    }
    assert_eq!(first, pose);
    pose
}

/// The pose that a decoder of pairs finds in the middle of a motion, as the second of two.
fn decode_pair(decoder: &mut PairDecoder<'_, '_>, code: &Code, frames: u32) -> Pose {
    decoder.start(code);
    let mut poses = [Pose::new(), Pose::new()];
    decoder.decode([FramePosition::from_frames(0), middle(frames)], &mut poses);
    let [_, pose] = poses;
    pose
}

fn middle(frames: u32) -> FramePosition {
    FramePosition::from_bits(frames << 15)
}
