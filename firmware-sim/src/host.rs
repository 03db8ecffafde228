//! The host's half of every comparison: `core`'s own arithmetic, compiled for this machine.
//!
//! In:  a [`Model`], [`Case`]s.
//! Out: poses to `parity.rs`.

use karakuri::limits::WIDTH_MAX;
use karakuri::{Decoder, Model, SampleError, Workspace};

use crate::case::Case;
use crate::error::{BLOB, Error, Result};

/// A workspace for any model that `core` accepts; too large for a thread's stack.
pub fn widest_workspace() -> Box<Workspace<WIDTH_MAX>> {
    Box::default()
}

/// Poses of all cases, Q15.16 in channel units. // (pose, channel)
///
/// # Errors
/// [`Error::Blob`], or [`Error::BadInput`] for a case that the model cannot sample.
pub fn decode_cases(model: &Model<'_>, cases: &[Case]) -> Result<Vec<Vec<i32>>> {
    let mut workspace = widest_workspace();
    let mut decoder = Decoder::new(model, &mut workspace)?;
    let mut poses = Vec::new();
    for case in cases {
        case.decode(model, &mut decoder, |pose| poses.push(pose.channels().to_vec()))
            .map_err(|error| unknown_motion(case, error))?;
    }
    Ok(poses)
}

fn unknown_motion(case: &Case, error: SampleError) -> Error {
    let motion = format!("action {}, {} frames", case.action, case.frames);
    let remedy = "choose cases for this very model";
    Error::bad_input(BLOB, "case", motion, format!("a trained motion ({error})"), remedy)
}
