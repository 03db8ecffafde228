//! The clips of all rows: read once, brought into each row's representation when a stage asks for them.
//!
//! In:  the folder of the data and the flags of the experiments.
//! Out: [`SplitClips`]; a fingerprint of the files, to every key.
//!
//! Why here: when every result is on the disk already, nothing but the fingerprint is needed.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use crate::body::skeleton::Skeleton;
use crate::clip::ClipSet;
use crate::commands::clips::{SplitClips, split};
use crate::commands::inspect_clips::ImportArgs;
use crate::config::TrainConfig;
use crate::error::{Error, Result};
use crate::evaluate::real::RealMotions;
use crate::hold_out::hold_out;
use crate::import;
use crate::reproduce::cache::Key;

/// The data of one `reproduce`.
pub struct Clips {
    path: PathBuf,
    args: ImportArgs,
    /// Names the files' bytes and the flags.
    pub fingerprint: String,
    read: Option<ClipSet>,
    splits: HashMap<String, Rc<SplitClips>>,
    real: HashMap<String, Rc<RealMotions>>,
}

impl Clips {
    /// Finds the files and takes their fingerprint.
    ///
    /// # Errors
    /// `BadInput` when the folder does not exist; `Io` when a file cannot be read.
    pub fn open(path: &Path, args: ImportArgs) -> Result<Self> {
        if !path.is_dir() {
            let remedy = "give the folder of the clips and their labels by --data";
            return Err(Error::bad_input(path, "--data", "no folder", "a folder", remedy));
        }
        let mut key = Key::new("clips").with(format!("{args:?}"));
        for file in files(path)? {
            let bytes = fs::read(&file).map_err(Error::io("read", &file))?;
            let name = file.strip_prefix(path).unwrap_or(&file);
            key = key.with(name.to_string_lossy().as_bytes()).with(bytes);
        }
        let (path, fingerprint) = (path.to_owned(), key.digits());
        Ok(Self {
            path,
            args,
            fingerprint,
            read: None,
            splits: HashMap::new(),
            real: HashMap::new(),
        })
    }

    /// Training and held-out clips as a configuration wants them.
    ///
    /// # Errors
    /// Whatever the importer, the split or the representation has to say about a file.
    pub fn of(&mut self, config: &TrainConfig) -> Result<Rc<SplitClips>> {
        let TrainConfig { representation, standardization, hold_out, seed, .. } = config;
        let name = format!("{representation:?} {standardization:?} {hold_out} {seed}");
        if let Some(split) = self.splits.get(&name) {
            return Ok(Rc::clone(split));
        }
        let clip_set = self.clip_set()?.clone();
        let skeleton = self.args.skeleton.as_deref().map(Skeleton::by_name_or_file).transpose()?;
        let split = Rc::new(split(clip_set, skeleton, config)?);
        self.splits.insert(name, Rc::clone(&split));
        Ok(split)
    }

    /// Both sides of a configuration's split as they were recorded, to measure against.
    ///
    /// # Errors
    /// Clips that are not those of a body, or cannot be read or split.
    pub fn real(&mut self, config: &TrainConfig) -> Result<Rc<RealMotions>> {
        let name = format!("{} {}", config.hold_out, config.seed);
        if let Some(real) = self.real.get(&name) {
            return Ok(Rc::clone(real));
        }
        let mut clip_set = self.clip_set()?.clone();
        if let Some(skeleton) = &self.args.skeleton {
            clip_set.skeleton = Some(Skeleton::by_name_or_file(skeleton)?);
        }
        let (training, held_out) = hold_out(clip_set, config.hold_out, config.seed)?;
        let real = Rc::new(RealMotions::new(&training, held_out.as_ref())?);
        self.real.insert(name, Rc::clone(&real));
        Ok(real)
    }

    fn clip_set(&mut self) -> Result<&ClipSet> {
        let clip_set = match self.read.take() {
            Some(clip_set) => clip_set,
            None => import::read(&self.path, &self.args.options()?)?,
        };
        Ok(self.read.insert(clip_set))
    }
}

/// All files under a folder, in order of their paths.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if path.is_dir() {
            found.extend(files(&path)?);
        } else {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_folder_is_refused_with_the_flag() {
        let error = Clips::open(Path::new("/no/clips"), ImportArgs::default()).err().unwrap();
        assert!(error.to_string().contains("--data"), "{error}");
    }

    #[test]
    fn fingerprint_follows_names_bytes_and_flags() {
        let folder = tempfile::tempdir().unwrap();
        let fingerprint = |rate_hz| {
            let args = ImportArgs { rate_hz, ..ImportArgs::default() };
            Clips::open(folder.path(), args).unwrap().fingerprint
        };
        fs::create_dir(folder.path().join("clips")).unwrap();
        let file = |name: &str| folder.path().join("clips").join(name);
        fs::write(file("a"), "1").unwrap();
        let first = fingerprint(None);
        assert_eq!(fingerprint(None), first);
        assert_ne!(fingerprint(Some(20.0)), first);
        fs::write(file("a"), "2").unwrap();
        assert_ne!(fingerprint(None), first);
        fs::remove_file(file("a")).unwrap();
        fs::write(file("b"), "1").unwrap();
        assert_ne!(fingerprint(None), first);
    }
}
