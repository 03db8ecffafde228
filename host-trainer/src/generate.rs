//! New motions: (action, length, seed) → poses, by the float model or by the device's own arithmetic.
//!
//! In:  a checkpoint with its mixtures, or the bytes of a blob.
//! Out: [`Motion`]s to `export` and `picture`.
//!
//! Why here: a blob is decoded by `karakuri` itself, never by a second implementation of its arithmetic.

use std::path::Path;

use karakuri::{Decoder, FramePosition, Model, Pcg32, Pose, Workspace};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::body::skeleton::Skeleton;
use crate::checkpoint::{Checkpoint, hexadecimal};
use crate::error::{Error, Result};
use crate::evaluate::source::CodeSampler;
use crate::export::Motion;
use crate::layout::{Group, PoseLayout};
use crate::mixture::set::MixtureSet;

/// What the user asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Name of the action.
    pub action: String,
    /// Length of the motion.
    pub seconds: f64,
    /// Seed of the motion.
    pub seed: u64,
    /// Move a length outside training to the nearest trained one instead of refusing it.
    pub clamp: bool,
    /// Poses per second; `None`: as the clips. Others are decoded between the frames, not interpolated.
    pub rate_hz: Option<f64>,
}

/// Widest decoder that the host decodes from a blob.
const WORKSPACE_WIDTH: usize = karakuri::limits::WIDTH_MAX;

/// Generates by the float model. The sampler draws from ChaCha8 seeded with the request's seed; `mixtures` say which
/// lengths were trained.
///
/// # Errors
/// An unknown action; a length outside training without `clamp`.
pub fn generate_float(
    checkpoint: &Checkpoint,
    mixtures: &MixtureSet,
    sampler: &dyn CodeSampler,
    request: &Request,
) -> Result<Motion> {
    let dataset = &checkpoint.dataset;
    let action = find_action(dataset.actions.iter().map(String::as_str), request)?;
    let mut frames = frames_of(request, dataset.rate_hz);
    if request.clamp {
        frames = mixtures.clamp_frames(action, frames)?;
    }
    let mut random = ChaCha8Rng::seed_from_u64(request.seed);
    let mut code = sampler.sample(action, frames, &mut random)?;
    code.extend(checkpoint.action_codes.mean_of(action));
    let times: Vec<f64> = frame_positions(frames, dataset.rate_hz, request).collect();
    let mut poses = vec![0.0; times.len() * dataset.layout.channel_count()];
    checkpoint.model.decode_motion(&code, &times, &mut poses);
    dataset.destandardize(&mut poses);
    Ok(Motion {
        layout: dataset.layout.clone(),
        skeleton: dataset.skeleton.clone(),
        rate_hz: request.rate_hz.unwrap_or(dataset.rate_hz),
        poses,
        action: request.action.clone(),
        seconds: frames as f64 / dataset.rate_hz,
        seed: request.seed,
        provenance: format!("float model, config {}", checkpoint.state.config_hash),
    })
}

/// Generates from a blob, with the same code, seed and arithmetic as the device.
///
/// # Errors
/// An unknown action; a length outside training without `clamp`; a blob that `path` names and core refuses.
pub fn generate_blob(path: &Path, model: &Model<'_>, request: &Request) -> Result<Motion> {
    let action = find_action(model.actions(), request)?;
    let action = karakuri::ActionId(action as u16);
    let rate_hz = f64::from(model.rate_millihz()) / 1000.0;
    let trained = model.trained_frames(action);
    let mut frames = frames_of(request, rate_hz) as u32;
    if request.clamp {
        frames = frames.clamp(*trained.start(), *trained.end());
    }
    let mut random = Pcg32::new(request.seed);
    let code = model.sample(action, frames, &mut || random.next_u32()).map_err(|_| {
        let seconds = |frames: u32| f64::from(frames) / rate_hz;
        outside_training(request, seconds(*trained.start()), seconds(*trained.end()))
    })?;
    let mut workspace = Box::new(Workspace::<WORKSPACE_WIDTH>::new());
    let mut decoder = Decoder::new(model, &mut *workspace)
        .map_err(|reason| Error::Blob { path: path.into(), reason: reason.to_string() })?;
    decoder.start(&code);
    let (mut pose, mut poses) = (Pose::new(), Vec::new());
    for position in frame_positions(frames as usize, rate_hz, request) {
        // Truncated to 2^-16 of a frame, as `FramePosition::after_us` does on the device.
        decoder.decode(FramePosition::from_bits((position * 65_536.0) as u32), &mut pose);
        poses.extend(pose.values().map(|value| value as f32));
    }
    Ok(Motion {
        layout: layout_of(model),
        skeleton: skeleton_of(model),
        rate_hz: request.rate_hz.unwrap_or(rate_hz),
        poses,
        action: request.action.clone(),
        seconds: f64::from(frames) / rate_hz,
        seed: request.seed,
        provenance: format!(
            "{} in core's {}, config {}",
            model.manifest().name,
            model.number_format().name(),
            hexadecimal(&model.provenance().config_hash)
        ),
    })
}

/// The layout that a blob carries.
pub fn layout_of(model: &Model<'_>) -> PoseLayout {
    let groups = model.groups().map(|group| Group {
        name: group.name.into(),
        kind: group.kind,
        unit: group.unit,
    });
    PoseLayout { groups: groups.collect() }
}

/// The skeleton that a blob carries, if any.
pub fn skeleton_of(model: &Model<'_>) -> Option<Skeleton> {
    let names: Vec<String> = model.joints().map(|joint| joint.name.into()).collect();
    (!names.is_empty()).then(|| Skeleton {
        names,
        parents: model.joints().map(|joint| joint.parent.map(usize::from)).collect(),
        offsets: model.joints().map(|joint| joint.offset).collect(),
    })
}

fn frames_of(request: &Request, rate_hz: f64) -> usize {
    (request.seconds * rate_hz).round().clamp(0.0, 65_535.0) as usize
}

/// Where the poses of a motion lie, in the model's frames; all below `frames`.
fn frame_positions(
    frames: usize,
    model_hz: f64,
    request: &Request,
) -> impl Iterator<Item = f64> + use<> {
    let per_pose = request.rate_hz.map_or(1.0, |rate_hz| model_hz / rate_hz);
    (0u32..).map(move |pose| f64::from(pose) * per_pose).take_while(move |at| *at < frames as f64)
}

fn find_action<'n>(names: impl Iterator<Item = &'n str>, request: &Request) -> Result<usize> {
    let names: Vec<&str> = names.collect();
    names.iter().position(|name| *name == request.action).ok_or_else(|| {
        Error::bad_input(
            "--action",
            "the action",
            &request.action,
            format!("one of {}", names.join(", ")),
            "choose one of these, or train with clips of it",
        )
    })
}

fn outside_training(request: &Request, seconds_min: f64, seconds_max: f64) -> Error {
    Error::bad_input(
        "--seconds",
        format!("the length of {}", request.action),
        format!("{} s", request.seconds),
        format!("{seconds_min:.2} to {seconds_max:.2} s, as in the clips"),
        "ask for a trained length, or add --clamp to take the nearest",
    )
}
