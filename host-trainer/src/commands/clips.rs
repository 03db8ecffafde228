//! From the path of a clip folder to datasets: the same for every verb that learns or measures.

use std::path::Path;

use crate::body::rotation::Vector;
use crate::body::skeleton::Skeleton;
use crate::clip::ClipSet;
use crate::commands::inspect_clips::ImportArgs;
use crate::config::TrainConfig;
use crate::dataset::{self, Dataset, DatasetOptions};
use crate::error::Result;
use crate::hold_out::hold_out;
use crate::import;
use crate::represent::represent_with_bones;

/// A dataset and, for rotations found by inverse kinematics, every clip's own bones. // (clip, joint)
pub struct ClipData {
    /// Standardised poses.
    pub dataset: Dataset,
    /// Empty unless the representation has rotations and the clips had positions.
    pub bones: Vec<Vec<Vector>>,
}

/// The two sides of the split.
pub struct SplitClips {
    /// What is trained on.
    pub training: ClipData,
    /// What is not; `None` when the configuration holds nothing out.
    pub held_out: Option<ClipData>,
}

/// Reads clips, splits them, brings them into the configuration's representation and standardises them.
///
/// # Errors
/// Whatever the importer, the split, the representation or the dataset has to say about a file.
pub fn read_clip_data(path: &Path, args: &ImportArgs, config: &TrainConfig) -> Result<SplitClips> {
    let (clip_set, skeleton) = read_clip_set(path, args)?;
    split(clip_set, skeleton, config)
}

/// Reads clips as they are, and the skeleton that the flags name.
///
/// # Errors
/// Whatever the importer has to say about a file, or a skeleton that does not exist.
pub fn read_clip_set(path: &Path, args: &ImportArgs) -> Result<(ClipSet, Option<Skeleton>)> {
    let clip_set = import::read(path, &args.options()?)?;
    for remark in &clip_set.remarks {
        eprintln!("{remark}");
    }
    let skeleton = args.skeleton.as_deref().map(Skeleton::by_name_or_file).transpose()?;
    Ok((clip_set, skeleton))
}

/// Held-out clips take skeleton, mean and scale from the training clips, and give nothing to them.
///
/// # Errors
/// As [`read_clip_data`].
pub fn split(
    clip_set: ClipSet,
    skeleton: Option<Skeleton>,
    config: &TrainConfig,
) -> Result<SplitClips> {
    let (training, held_out) = hold_out(clip_set, config.hold_out, config.seed)?;
    let (training, bones) = represent_with_bones(training, config.representation, skeleton)?;
    let options = DatasetOptions { standardization: config.standardization };
    let mut dataset = dataset::build(&training, &options)?;
    let mut like_training = |clip_set| {
        let skeleton = training.skeleton.clone();
        let (clip_set, bones) = represent_with_bones(clip_set, config.representation, skeleton)?;
        Ok(ClipData { dataset: dataset::build_held_out(&clip_set, &mut dataset)?, bones })
    };
    let held_out = held_out.map(&mut like_training).transpose()?;
    Ok(SplitClips { training: ClipData { dataset, bones }, held_out })
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::character;
    use crate::checkpoint::Checkpoint;
    use crate::clip::Clip;
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};
    use crate::represent::Representation;
    use crate::train::synthetic;
    use crate::train::{Progress, Start, TrainOptions, train};

    fn config(representation: Representation) -> TrainConfig {
        let config = synthetic::config("[budget]\nsteps = 20");
        TrainConfig { hold_out: 0.25, representation, ..config }
    }

    fn trained_bytes(clip_set: &ClipSet, config: &TrainConfig) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let options = TrainOptions {
            start: Start::New,
            thread_count: Some(1),
            stop: &AtomicBool::new(false),
            resume_command: "",
            progress: Progress::Hidden,
        };
        let data = split(clip_set.clone(), None, config).unwrap();
        train(&data.training.dataset, config, &run, &options).unwrap();
        fs::read(run.join(Checkpoint::FILE_NAME)).unwrap()
    }

    /// The same clips, of which the last one on that side of the split moves otherwise.
    fn with_other_poses(clip_set: &ClipSet, data: &ClipData) -> ClipSet {
        let name = &data.dataset.description.clips.last().unwrap().name;
        let mut other = clip_set.clone();
        let clip = other.clips.iter_mut().find(|clip| clip.name == *name).unwrap();
        clip.poses.iter_mut().for_each(|value| *value = 1.5 * *value + 0.1);
        other
    }

    /// Three joints in a row that swing, in positions.
    fn swings() -> ClipSet {
        let joint = |name: &str| Group {
            name: name.to_owned(),
            kind: GroupKind::Position,
            unit: Unit::Metre,
        };
        let pose = |angle: f32| {
            let (sine, cosine) = angle.sin_cos();
            [[0.0; 3], [sine, cosine, 0.0], [sine, cosine, 0.5]].concat()
        };
        let clip = |number: usize| Clip {
            name: format!("swing{number}"),
            action: "swing".to_owned(),
            source: "memory".into(),
            poses: (0..20).flat_map(|frame| pose(0.05 * (frame * (number + 1)) as f32)).collect(),
        };
        ClipSet {
            layout: PoseLayout { groups: ["hip", "knee", "toe"].map(joint).to_vec() },
            rate_hz: 20.0,
            skeleton: None,
            clips: (0..8).map(clip).collect(),
            remarks: Vec::new(),
        }
    }

    #[test]
    fn poses_of_held_out_clips_do_not_change_a_byte_of_the_checkpoint() {
        let servos = (character::clip_set(3, 4), config(Representation::AsIs));
        // With rotations the skeleton itself is measured on the clips.
        let joints = (swings(), config(Representation::Rotations));
        for (clip_set, config) in [servos, joints] {
            let data = split(clip_set.clone(), None, &config).unwrap();
            let held_out = with_other_poses(&clip_set, &data.held_out.unwrap());
            let training = with_other_poses(&clip_set, &data.training);
            let bytes = trained_bytes(&clip_set, &config);
            assert!(trained_bytes(&held_out, &config) == bytes, "{:?}", config.representation);
            assert!(trained_bytes(&training, &config) != bytes, "{:?}", config.representation);
        }
    }

    #[test]
    fn checkpoint_names_the_held_out_clips() {
        let (clip_set, config) = (character::clip_set(3, 4), config(Representation::AsIs));
        let data = split(clip_set, None, &config).unwrap();
        let checkpoint = Checkpoint::start(&data.training.dataset, &config);
        let held_out = data.held_out.unwrap().dataset.description;
        assert_eq!(checkpoint.dataset.held_out, held_out.clips);
        assert_eq!(held_out.clips.len(), checkpoint.dataset.actions.len());
        let is_trained = |name| checkpoint.dataset.clips.iter().any(|clip| clip.name == name);
        assert!(held_out.clips.into_iter().all(|clip| !is_trained(clip.name)));
    }

    #[test]
    fn held_out_poses_come_back_in_channel_units() {
        let (clip_set, config) = (character::clip_set(3, 4), config(Representation::AsIs));
        let held_out = split(clip_set.clone(), None, &config).unwrap().held_out.unwrap().dataset;
        for (index, description) in held_out.description.clips.iter().enumerate() {
            let clip = clip_set.clips.iter().find(|clip| clip.name == description.name).unwrap();
            let mut poses = held_out.clip_poses(index).to_vec();
            held_out.description.destandardize(&mut poses);
            assert!(poses.iter().zip(&clip.poses).all(|(a, b)| (a - b).abs() < 1e-3));
        }
    }
}
