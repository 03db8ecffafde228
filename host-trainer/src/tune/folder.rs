//! The folder of a tuned run: begun, or gone on with.
//!
//! In:  the checkpoint as tuning would begin; the folder.
//! Out: the checkpoint to go on from, or an error that names what differs.

use std::fs;
use std::path::Path;

use crate::atomic_file;
use crate::checkpoint::Checkpoint;
use crate::error::{Error, Result};
use crate::train::CONFIG_FILE_NAME;
use crate::tune::tuning_of;

/// Makes the folder with the checkpoint before the first step.
///
/// # Errors
/// `BadInput` when the folder is in use; `Io` when it cannot be written.
pub fn create(start: &Checkpoint, out: &Path) -> Result<Checkpoint> {
    let is_taken =
        out.exists() && fs::read_dir(out).map_or(true, |mut entries| entries.next().is_some());
    if is_taken {
        let remedy = "choose another folder, or go on with --resume";
        return Err(Error::bad_input(out, "--out", "in use", "a new folder", remedy));
    }
    fs::create_dir_all(out).map_err(Error::io("create", out))?;
    if let Err(error) = start.save(out) {
        // Best effort, and only what is empty: an attempt that failed should leave nothing behind.
        let _ = fs::remove_dir(out);
        return Err(error);
    }
    let text = start.config.to_toml();
    atomic_file::replace(&out.join(CONFIG_FILE_NAME), |file| {
        std::io::Write::write_all(file, text.as_bytes())
    })?;
    Ok(start.clone())
}

/// The saved checkpoint, if it was begun as `start` would be.
///
/// # Errors
/// `BadInput` when there is none, or it was begun otherwise.
pub fn resume(start: &Checkpoint, out: &Path) -> Result<Checkpoint> {
    if !out.join(Checkpoint::FILE_NAME).exists() {
        let remedy = "leave --resume off to start, in a new folder";
        return Err(Error::bad_input(out, "checkpoint", "missing", "a tuned run", remedy));
    }
    let checkpoint = Checkpoint::load(out)?;
    let Some(then) = &checkpoint.state.tuning else {
        let remedy = "give the --out of an interrupted `host-trainer tune`";
        return Err(Error::bad_input(out, "checkpoint", "not tuned", "a tuned run", remedy));
    };
    let now = tuning_of(start);
    let facts = [
        ("format", now.format.clone(), then.format.clone()),
        ("bits of weights", bits(&now.weight_bits), bits(&then.weight_bits)),
        ("hash of RUN", now.parent_hash.clone(), then.parent_hash.clone()),
        ("--seed", now.seed.to_string(), then.seed.to_string()),
        ("--steps", now.step_count.to_string(), then.step_count.to_string()),
        ("--learning-rate", now.learning_rate.to_string(), then.learning_rate.to_string()),
    ];
    match facts.into_iter().find(|(_, now, then)| now != then) {
        None => Ok(checkpoint),
        Some((field, now, then)) => {
            let expected = format!("{then}, as when it began");
            let remedy = "repeat the first command with --resume, or choose another --out";
            Err(Error::bad_input(out, field, now, expected, remedy))
        }
    }
}

/// As a person reads them.
fn bits(weight_bits: &[u8]) -> String {
    if weight_bits.is_empty() {
        return "the default".to_owned();
    }
    weight_bits.iter().map(u8::to_string).collect::<Vec<_>>().join(" ")
}
