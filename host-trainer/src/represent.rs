//! Station 1b: clips as imported → clips as trained.
//!
//! In:  [`ClipSet`] of an importer; human joints come as absolute positions, one `Position` group a
//! joint.
//! Out: [`ClipSet`] in its training representation to `dataset`.
//!
//! Why here: the decoder learns what it is given. Positions are simplest and exact; rotations can
//! be sent to motors and keep bones rigid.

pub mod rotations;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::body::Body;
use crate::body::rotation::{Vector, subtract};
use crate::body::skeleton::Skeleton;
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};
use crate::represent::rotations::rotations;

pub use crate::body::to_joint_positions;

/// How joints are given to the decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Representation {
    /// The channels of the importer, untouched.
    #[default]
    AsIs,
    /// Root translation since frame 0, and every other joint relative to the root of its frame.
    Positions,
    /// Root translation since frame 0, and one local rotation a joint, joint 0 being the global
    /// orientation.
    Rotations,
}

/// Name of the root's translation group.
pub const ROOT_NAME: &str = "root";

/// Brings a clip set into its training representation.
///
/// `skeleton` replaces the set's own; its joint names become the group names. `Rotations` without
/// any skeleton infers the tree from the distances that stay constant, and says so in the remarks.
///
/// # Errors
/// - `Positions` or `Rotations` of clips that are not a body.
/// - A skeleton that is not a tree, or has another number of joints than the clips.
pub fn represent(
    clip_set: ClipSet,
    representation: Representation,
    skeleton: Option<Skeleton>,
) -> Result<ClipSet> {
    represent_with_bones(clip_set, representation, skeleton).map(|(clip_set, _)| clip_set)
}

/// As [`represent`]; also every clip's own bones, which forward kinematics needs to give the clip's
/// positions back.
/// // (clip, joint); no clips unless rotations were found by inverse kinematics
pub fn represent_with_bones(
    mut clip_set: ClipSet,
    representation: Representation,
    skeleton: Option<Skeleton>,
) -> Result<(ClipSet, Vec<Vec<Vector>>)> {
    if let Some(skeleton) = skeleton {
        skeleton.check(source_of(&clip_set))?;
        clip_set.skeleton = Some(skeleton);
    }
    if representation == Representation::AsIs {
        return Ok((clip_set, Vec::new()));
    }
    let body = check_body(&clip_set)?;
    if representation == Representation::Rotations && body.has_rotations() {
        return Ok((rebase_roots(clip_set), Vec::new()));
    }
    let joints = clip_set
        .clips
        .par_iter()
        .map(|clip| since_first_root(&body, &clip_set.layout, clip))
        .collect();
    match representation {
        Representation::Rotations => rotations(clip_set, joints),
        _ => Ok((positions(clip_set, joints), Vec::new())),
    }
}

/// The file to blame for what concerns all clips.
pub(crate) fn source_of(clip_set: &ClipSet) -> &std::path::Path {
    let first = clip_set.clips.first();
    first.map_or(std::path::Path::new("clips"), |clip| clip.source.as_path())
}

fn check_body(clip_set: &ClipSet) -> Result<Body> {
    let body = Body::new(&clip_set.layout, clip_set.skeleton.as_ref()).ok_or_else(|| {
        let kinds: Vec<&str> = clip_set.layout.groups.iter().map(|g| g.kind.name()).collect();
        Error::bad_input(
            source_of(clip_set),
            "channel groups",
            kinds.join(" "),
            "joint positions, or a root translation and the rotations of a skeleton's joints",
            "use the representation as-is, or name the skeleton",
        )
    })?;
    match &clip_set.skeleton {
        Some(skeleton) if skeleton.joint_count() != body.joint_count() => Err(Error::bad_input(
            source_of(clip_set),
            "joints",
            body.joint_count(),
            format!("{}, as in the skeleton", skeleton.joint_count()),
            "name the skeleton of these clips",
        )),
        _ => Ok(body),
    }
}

/// Joint positions of a clip, minus the root of its first frame. // (frame, joint)
fn since_first_root(body: &Body, layout: &PoseLayout, clip: &Clip) -> Vec<Vec<Vector>> {
    let poses = clip.poses.chunks_exact(layout.channel_count());
    let mut frames: Vec<Vec<Vector>> = poses.map(|pose| body.joint_positions(pose)).collect();
    let origin = frames.first().map_or([0.0; 3], |first| first[0]);
    for position in frames.iter_mut().flatten() {
        *position = subtract(*position, origin);
    }
    frames
}

/// Rotations of the source stay what they are, twist included; only the root starts at zero.
fn rebase_roots(mut clip_set: ClipSet) -> ClipSet {
    let layout = &clip_set.layout;
    let root = layout.ranges().find(|(group, _)| group.kind == GroupKind::Translation);
    let root = root.map_or(0..0, |(_, range)| range);
    for clip in &mut clip_set.clips {
        let start: Vec<f32> = clip.poses.get(root.clone()).unwrap_or_default().to_vec();
        for pose in clip.poses.chunks_exact_mut(layout.channel_count()) {
            for (value, start) in pose[root.clone()].iter_mut().zip(&start) {
                *value -= start;
            }
        }
    }
    clip_set
}

/// Layout of the root's translation and one group of `kind` for each of `names`.
pub(crate) fn body_layout(
    clip_set: &ClipSet,
    kind: GroupKind,
    names: impl IntoIterator<Item = String>,
) -> PoseLayout {
    let of_position = |group: &&Group| group.kind != GroupKind::Rotation6d;
    let length = clip_set.layout.groups.iter().find(of_position);
    let length = length.map_or(Unit::Metre, |group| group.unit);
    let unit = if kind == GroupKind::Rotation6d { Unit::One } else { length };
    let root = Group { name: ROOT_NAME.to_owned(), kind: GroupKind::Translation, unit: length };
    let others = names.into_iter().map(|name| Group { name, kind, unit });
    PoseLayout { groups: std::iter::once(root).chain(others).collect() }
}

/// The skeleton's names, else the groups'; "root" is the translation's and never a joint's.
pub(crate) fn joint_names(clip_set: &ClipSet) -> Vec<String> {
    let mut names: Vec<String> = match &clip_set.skeleton {
        Some(skeleton) => skeleton.names.clone(),
        None => clip_set.layout.groups.iter().map(|group| group.name.clone()).collect(),
    };
    if let Some(name) = names.iter_mut().find(|name| *name == ROOT_NAME) {
        name.push_str("_joint");
    }
    names
}

fn positions(mut clip_set: ClipSet, joints: Vec<Vec<Vec<Vector>>>) -> ClipSet {
    let names = joint_names(&clip_set).into_iter().skip(1);
    clip_set.layout = body_layout(&clip_set, GroupKind::Position, names);
    for (clip, frames) in clip_set.clips.iter_mut().zip(joints) {
        let relative = frames.iter().flat_map(|positions| {
            let others = positions[1..].iter().map(|position| subtract(*position, positions[0]));
            std::iter::once(positions[0]).chain(others)
        });
        clip.poses = relative.flatten().map(|element| element as f32).collect();
    }
    clip_set
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::kinematics::joint_distances;
    use std::path::{Path, PathBuf};

    fn absolute_layout(joint_count: usize) -> PoseLayout {
        let groups = (0..joint_count)
            .map(|joint| Group {
                name: format!("joint{joint}"),
                kind: GroupKind::Position,
                unit: Unit::Metre,
            })
            .collect();
        PoseLayout { groups }
    }

    fn clip_set(joint_count: usize, clips: Vec<Clip>) -> ClipSet {
        ClipSet {
            layout: absolute_layout(joint_count),
            rate_hz: 20.0,
            skeleton: None,
            clips,
            remarks: Vec::new(),
        }
    }

    fn clip(name: &str, poses: Vec<f32>) -> Clip {
        Clip { name: name.to_owned(), action: "a".to_owned(), source: PathBuf::from(name), poses }
    }

    /// A path below `shared/`, or `None` with a loud word when this machine has no such data.
    fn shared(path: &str) -> Option<PathBuf> {
        let roots = ["/../../shared", "/../../../shared"];
        let roots =
            roots.map(|up| PathBuf::from(format!("{}{up}/{path}", env!("CARGO_MANIFEST_DIR"))));
        let found = roots.into_iter().find(|path| path.exists());
        if found.is_none() {
            assert!(std::env::var_os("CI").is_none(), "CI needs shared/{path}");
            eprintln!("SKIPPED: shared/{path} is not on this machine");
        }
        found
    }

    fn read_npy(path: &Path) -> Vec<f32> {
        let bytes = std::fs::read(path).unwrap();
        npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap()
    }

    /// Every `step`-th clip of a folder of `.npy` files.
    fn npy_clips(folder: &Path, joint_count: usize, step: usize) -> ClipSet {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        let clips = files
            .iter()
            .step_by(step)
            .map(|file| clip(&file.file_stem().unwrap().to_string_lossy(), read_npy(file)))
            .collect();
        clip_set(joint_count, clips)
    }

    #[test]
    fn servo_channels_are_refused_as_positions() {
        let mut set = clip_set(2, vec![clip("c", vec![0.0; 12])]);
        set.layout.groups[1].kind = GroupKind::Scalar;
        let error = represent(set, Representation::Positions, None).unwrap_err().to_string();
        assert!(error.contains("as-is"), "{error}");
    }

    #[test]
    fn skeleton_of_another_size_is_refused() {
        let set = clip_set(2, vec![clip("c", vec![0.0; 12])]);
        let skeleton = Some(Skeleton::smpl24());
        let error = represent(set, Representation::Rotations, skeleton).unwrap_err().to_string();
        assert!(error.contains("joints is 2, expected 24"), "{error}");
    }

    #[test]
    fn as_is_changes_no_channel() {
        let set = clip_set(2, vec![clip("c", (0..12).map(|x| x as f32).collect())]);
        assert_eq!(represent(set.clone(), Representation::AsIs, None).unwrap(), set);
    }

    #[test]
    fn positions_are_relative_and_come_back() {
        let original: Vec<f32> = (0..18).map(|x| (x * x) as f32).collect();
        let set = clip_set(3, vec![clip("c", original)]);
        let set = represent(set, Representation::Positions, None).unwrap();
        assert_eq!(set.layout.channel_count(), 9);
        assert_eq!(set.layout.groups[0].kind, GroupKind::Translation);
        let first = to_joint_positions(&set.layout, &set.clips[0].poses[..9], None).unwrap();
        assert_eq!(first, [[0.0; 3], [9.0, 15.0, 21.0], [36.0, 48.0, 60.0]]);
        let second = to_joint_positions(&set.layout, &set.clips[0].poses[9..], None).unwrap();
        assert_eq!(second[0], [81.0, 99.0, 117.0]);
        assert_eq!(second[2], [225.0, 255.0, 285.0]);
    }

    #[test]
    fn rotations_of_the_source_keep_their_twist() {
        let groups = [("root", GroupKind::Translation), ("hip", GroupKind::Rotation6d)];
        let groups =
            groups.map(|(name, kind)| Group { name: name.to_owned(), kind, unit: Unit::Metre });
        let twist = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0];
        let pose = |x: f32| [[x, 2.0, 3.0].as_slice(), &twist].concat();
        let mut set = clip_set(1, vec![clip("c", [pose(5.0), pose(7.0)].concat())]);
        set.layout = PoseLayout { groups: groups.to_vec() };
        set.skeleton = Some(Skeleton {
            names: vec!["hip".to_owned()],
            parents: vec![None],
            offsets: vec![[0.0; 3]],
        });
        let set = represent(set, Representation::Rotations, None).unwrap();
        assert_eq!(set.clips[0].poses[..3], [0.0; 3]);
        assert_eq!(set.clips[0].poses[9..12], [2.0, 0.0, 0.0]);
        assert_eq!(set.clips[0].poses[12..], twist);
    }

    #[test]
    fn rotations_reproduce_humanact12_within_a_tenth_of_a_millimetre() {
        let Some(folder) = shared("data/humanact12/clips") else {
            return;
        };
        let set = npy_clips(&folder, 24, 30);
        assert_eq!(set.clips.len(), 40);
        let absolute = set.clone();
        let (set, bones) =
            represent_with_bones(set, Representation::Rotations, Some(Skeleton::smpl24())).unwrap();
        assert_eq!(set.layout.channel_count(), 147);
        let body = Body::new(&set.layout, set.skeleton.as_ref()).unwrap();
        for ((original, clip), bones) in absolute.clips.iter().zip(&set.clips).zip(&bones) {
            let start = original.poses.first_chunk::<3>().unwrap().map(f64::from);
            let poses = clip.poses.chunks_exact(147);
            let distances: Vec<f64> = poses
                .zip(original.poses.chunks_exact(72))
                .flat_map(|(pose, xyz)| {
                    let found = body.joint_positions_on(bones, pose).unwrap();
                    let original: Vec<Vector> = xyz
                        .chunks_exact(3)
                        .map(|p| subtract([p[0], p[1], p[2]].map(f64::from), start))
                        .collect();
                    joint_distances(&found, &original).collect::<Vec<_>>()
                })
                .collect();
            let mean_m = distances.iter().sum::<f64>() / distances.len() as f64;
            assert!(mean_m < 1e-4, "{}: {mean_m} m", clip.name);
        }
        eprintln!("{}", set.remarks.join("\n"));
        assert!(set.remarks[0].contains("40 of 40 clips have constant bone lengths"));
    }

    #[test]
    fn inferred_tree_of_cmu_clips_is_the_published_one() {
        let Some(folder) = shared("data/cmu_mocap/clips") else {
            return;
        };
        let set = npy_clips(&folder, 20, 25);
        let set = represent(set, Representation::Rotations, None).unwrap();
        eprintln!("{}", set.remarks.join("\n"));
        assert_eq!(set.skeleton.unwrap().parents, Skeleton::cmu20().parents);
    }
}
