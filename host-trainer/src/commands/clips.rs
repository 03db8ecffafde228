//! From the path of a clip folder to a dataset: the same for every verb that learns or measures.

use std::path::Path;

use crate::body::rotation::Vector;
use crate::body::skeleton::Skeleton;
use crate::commands::inspect_clips::ImportArgs;
use crate::config::TrainConfig;
use crate::dataset::{self, Dataset, DatasetOptions};
use crate::error::Result;
use crate::import;
use crate::represent::represent_with_bones;

/// A dataset and, for rotations found by inverse kinematics, every clip's own bones. // (clip, joint)
pub struct ClipData {
    /// Standardised poses.
    pub dataset: Dataset,
    /// Empty unless the representation has rotations and the clips had positions.
    pub bones: Vec<Vec<Vector>>,
}

/// Reads clips, brings them into the configuration's representation and standardises them.
///
/// # Errors
/// Whatever the importer, the representation or the dataset has to say about a file.
pub fn read_clip_data(path: &Path, args: &ImportArgs, config: &TrainConfig) -> Result<ClipData> {
    let clip_set = import::read(path, &args.options()?)?;
    for remark in &clip_set.remarks {
        eprintln!("{remark}");
    }
    let skeleton = args.skeleton.as_deref().map(Skeleton::by_name_or_file).transpose()?;
    let (clip_set, bones) = represent_with_bones(clip_set, config.representation, skeleton)?;
    let dataset =
        dataset::build(&clip_set, &DatasetOptions { standardization: config.standardization })?;
    Ok(ClipData { dataset, bones })
}
