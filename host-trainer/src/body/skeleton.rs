//! The joint tree of a body: names, parents and rest offsets as parallel arrays; parents precede
//! children.
//!
//! In:  BVH hierarchies, the built-in trees, or a user's TOML.
//! Out: kinematics, pictures, and the blob.
//!
//! Source: joint order of `smpl24` from Loper et al., SIGGRAPH Asia 2015; kinematic chains of both
//! built-in trees from the read-me files of HumanAct12 and Action2Motion. The rest offsets are our
//! own round numbers.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// A joint tree; joint 0 is the root.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skeleton {
    /// Joint names. // (joint)
    pub names: Vec<String>,
    /// Index of the parent, smaller than the joint's own; `None` for the root alone. // (joint)
    pub parents: Vec<Option<usize>>,
    /// Offset from the parent at rest, in the unit of the layout's translation; zeros when only the
    /// tree is known. // (joint, xyz)
    pub offsets: Vec<[f32; 3]>,
}

/// The 24 joints of the SMPL body: name, parent, rest offset in metres.
///
/// Rest pose: arms out sideways, y up, x to the body's left, z forward; an adult of 1.7 m, rounded
/// to the centimetre.
#[rustfmt::skip]
const SMPL24: [(&str, usize, [f32; 3]); 24] = [
    ("pelvis",          0, [ 0.00,  0.00,  0.00]),
    ("left_hip",        0, [ 0.06, -0.09, -0.01]),
    ("right_hip",       0, [-0.06, -0.09, -0.01]),
    ("spine1",          0, [ 0.00,  0.12, -0.03]),
    ("left_knee",       1, [ 0.04, -0.38,  0.00]),
    ("right_knee",      2, [-0.04, -0.38,  0.00]),
    ("spine2",          3, [ 0.00,  0.13,  0.02]),
    ("left_ankle",      4, [-0.01, -0.41, -0.04]),
    ("right_ankle",     5, [ 0.01, -0.41, -0.04]),
    ("spine3",          6, [ 0.00,  0.06,  0.00]),
    ("left_foot",       7, [ 0.04, -0.06,  0.12]),
    ("right_foot",      8, [-0.04, -0.06,  0.12]),
    ("neck",            9, [ 0.00,  0.21, -0.03]),
    ("left_collar",     9, [ 0.08,  0.12, -0.02]),
    ("right_collar",    9, [-0.08,  0.12, -0.02]),
    ("head",           12, [ 0.00,  0.09,  0.05]),
    ("left_shoulder",  13, [ 0.10,  0.04, -0.01]),
    ("right_shoulder", 14, [-0.10,  0.04, -0.01]),
    ("left_elbow",     16, [ 0.26,  0.00, -0.02]),
    ("right_elbow",    17, [-0.26,  0.00, -0.02]),
    ("left_wrist",     18, [ 0.25,  0.00,  0.00]),
    ("right_wrist",    19, [-0.25,  0.00,  0.00]),
    ("left_hand",      20, [ 0.09,  0.00,  0.00]),
    ("right_hand",     21, [-0.09,  0.00,  0.00]),
];

/// The 20 joints of the CMU clips of Action2Motion; same rest pose, in the unit that is left after
/// dividing by 20.
#[rustfmt::skip]
const CMU20: [(&str, usize, [f32; 3]); 20] = [
    ("hips",            0, [ 0.00,  0.00,  0.00]),
    ("chest",           0, [ 0.00,  0.30,  0.00]),
    ("neck",            1, [ 0.00,  0.17,  0.00]),
    ("head",            2, [ 0.00,  0.08,  0.04]),
    ("left_shoulder",   1, [ 0.16,  0.07,  0.00]),
    ("left_elbow",      4, [ 0.26,  0.00,  0.00]),
    ("left_wrist",      5, [ 0.17,  0.00,  0.00]),
    ("left_hand",       6, [ 0.11,  0.00,  0.00]),
    ("right_shoulder",  1, [-0.16,  0.07,  0.00]),
    ("right_elbow",     8, [-0.26,  0.00,  0.00]),
    ("right_wrist",     9, [-0.17,  0.00,  0.00]),
    ("right_hand",     10, [-0.11,  0.00,  0.00]),
    ("left_hip",        0, [ 0.07, -0.10,  0.00]),
    ("left_knee",      12, [ 0.00, -0.36,  0.00]),
    ("left_ankle",     13, [ 0.00, -0.38,  0.00]),
    ("left_foot",      14, [ 0.00, -0.04,  0.15]),
    ("right_hip",       0, [-0.07, -0.10,  0.00]),
    ("right_knee",     16, [ 0.00, -0.36,  0.00]),
    ("right_ankle",    17, [ 0.00, -0.38,  0.00]),
    ("right_foot",     18, [ 0.00, -0.04,  0.15]),
];

/// A skeleton file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SkeletonFile {
    joint: Vec<JointEntry>,
}

/// One `[[joint]]` of a skeleton file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointEntry {
    name: String,
    parent: Option<String>,
    #[serde(default)]
    offset: [f32; 3],
}

impl Skeleton {
    /// The 24 joints of the SMPL body, offsets in metres.
    pub fn smpl24() -> Self {
        Self::from_table(&SMPL24)
    }

    /// The 20 joints of the CMU clips of Action2Motion.
    pub fn cmu20() -> Self {
        Self::from_table(&CMU20)
    }

    fn from_table(table: &[(&str, usize, [f32; 3])]) -> Self {
        Self {
            names: table.iter().map(|(name, _, _)| (*name).to_owned()).collect(),
            parents: table
                .iter()
                .enumerate()
                .map(|(joint, (_, parent, _))| (joint > 0).then_some(*parent))
                .collect(),
            offsets: table.iter().map(|(_, _, offset)| *offset).collect(),
        }
    }

    /// A built-in tree by its name (`smpl24`, `cmu20`), else a TOML file.
    ///
    /// The file lists the joints, parents first:
    /// ```toml
    /// [[joint]]
    /// name = "base"
    /// [[joint]]
    /// name = "jaw"
    /// parent = "base"
    /// offset = [0.0, 0.02, 0.05] # optional; in the unit of the clips
    /// ```
    ///
    /// # Errors
    /// - Neither a built-in name nor a readable file.
    /// - Not TOML of this form, or not a tree as [`Self::check`] wants it.
    pub fn by_name_or_file(name_or_file: &str) -> Result<Self> {
        match name_or_file {
            "smpl24" => Ok(Self::smpl24()),
            "cmu20" => Ok(Self::cmu20()),
            file => Self::read(Path::new(file)),
        }
    }

    fn read(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Err(Error::bad_input(
                path,
                "skeleton",
                "no such file",
                "smpl24, cmu20 or a TOML file",
                "check the spelling",
            ));
        }
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let file: SkeletonFile = toml::from_str(&text).map_err(|error| {
            Error::bad_input(
                path,
                "skeleton",
                error.to_string().trim_end().replace('\n', " "),
                "[[joint]] entries with name, parent and an optional offset",
                "see the documentation of --skeleton",
            )
        })?;
        let names: Vec<String> = file.joint.iter().map(|joint| joint.name.clone()).collect();
        let parents = file
            .joint
            .iter()
            .map(|joint| parent_index(path, &names, joint))
            .collect::<Result<_>>()?;
        let offsets = file.joint.iter().map(|joint| joint.offset).collect();
        let skeleton = Self { names, parents, offsets };
        skeleton.check(path)?;
        Ok(skeleton)
    }

    /// Checks that this is a tree: one root, at index 0; parents precede children; names are
    /// unique.
    ///
    /// # Errors
    /// Names the first joint that breaks a rule; `source` is the file to blame.
    pub fn check(&self, source: &Path) -> Result<()> {
        let joint_count = self.names.len();
        if joint_count == 0
            || self.parents.len() != joint_count
            || self.offsets.len() != joint_count
        {
            return Err(Error::bad_input(
                source,
                "skeleton",
                format!(
                    "{joint_count} names, {} parents, {} offsets",
                    self.parents.len(),
                    self.offsets.len()
                ),
                "one of each for every joint, and at least one joint",
                "list every joint once",
            ));
        }
        (0..joint_count).try_for_each(|joint| self.check_joint(source, joint))
    }

    fn check_joint(&self, source: &Path, joint: usize) -> Result<()> {
        let name = &self.names[joint];
        let refuse = |value: &str, expected: &str, remedy: &str| {
            Err(Error::bad_input(source, format!("joint {name}"), value, expected, remedy))
        };
        match self.parents[joint] {
            None if joint > 0 => {
                refuse("a second root", "one root, the first joint", "name its parent")
            }
            Some(parent) if parent >= joint => refuse(
                &format!("listed before its parent, joint {parent}"),
                "parents before children",
                "reorder the joints, and the clips' joints with them",
            ),
            _ if self.names[..joint].contains(name) => {
                refuse("named twice", "unique names", "rename one of the two")
            }
            _ if !self.offsets[joint].iter().all(|element| element.is_finite()) => {
                refuse("an infinite offset", "finite numbers", "repair the offset")
            }
            _ => Ok(()),
        }
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.names.len()
    }

    /// Children of every joint. // (joint)
    pub fn children(&self) -> Vec<Vec<usize>> {
        let mut children = vec![Vec::new(); self.joint_count()];
        for (joint, parent) in self.parents.iter().enumerate() {
            if let Some(parent) = parent {
                children[*parent].push(joint);
            }
        }
        children
    }

    /// Every bone as (parent, child).
    pub fn bones(&self) -> impl Iterator<Item = (usize, usize)> {
        self.parents
            .iter()
            .enumerate()
            .filter_map(|(joint, parent)| parent.map(|parent| (parent, joint)))
    }
}

fn parent_index(path: &Path, names: &[String], joint: &JointEntry) -> Result<Option<usize>> {
    let Some(parent) = &joint.parent else {
        return Ok(None);
    };
    let index = names.iter().position(|name| name == parent).ok_or_else(|| {
        Error::bad_input(
            path,
            format!("parent of joint {}", joint.name),
            parent,
            "the name of another joint of the file",
            "check the spelling",
        )
    })?;
    Ok(Some(index))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn refusal(text: &str) -> String {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        Skeleton::by_name_or_file(file.path().to_str().unwrap()).unwrap_err().to_string()
    }

    #[test]
    fn unknown_name_is_rejected_with_the_known_ones() {
        let error = Skeleton::by_name_or_file("smpl42").unwrap_err().to_string();
        assert!(error.contains("smpl42") && error.contains("smpl24"), "{error}");
    }

    #[test]
    fn broken_trees_are_rejected_by_joint() {
        for (text, expected) in [
            ("joint = []", "at least one joint"),
            ("[[joint]]\nnme = 'a'", "nme"),
            ("[[joint]]\nname = 'a'\n[[joint]]\nname = 'b'", "joint b is a second root"),
            (
                "[[joint]]\nname = 'a'\n[[joint]]\nname = 'b'\nparent = 'c'",
                "parent of joint b is c",
            ),
            ("[[joint]]\nname = 'a'\nparent = 'a'", "before its parent"),
            ("[[joint]]\nname = 'a'\n[[joint]]\nname = 'a'\nparent = 'a'", "named twice"),
            ("[[joint]]\nname = 'a'\noffset = [0, nan, 0]", "offset"),
        ] {
            let error = refusal(text);
            assert!(error.contains(expected), "{text:?} gave {error}");
        }
    }

    #[test]
    fn toml_tree_is_read() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let text = "[[joint]]\nname = 'base'\n\
                    [[joint]]\nname = 'jaw'\nparent = 'base'\noffset = [0.0, 1.0, 2.5]";
        file.write_all(text.as_bytes()).unwrap();
        let skeleton = Skeleton::by_name_or_file(file.path().to_str().unwrap()).unwrap();
        assert_eq!(skeleton.names, ["base", "jaw"]);
        assert_eq!(skeleton.parents, [None, Some(0)]);
        assert_eq!(skeleton.offsets[1], [0.0, 1.0, 2.5]);
    }

    #[test]
    fn built_in_trees_hold_the_published_chains() {
        let smpl = [
            vec![0, 1, 4, 7, 10],
            vec![0, 2, 5, 8, 11],
            vec![0, 3, 6, 9, 12, 15],
            vec![9, 13, 16, 18, 20, 22],
            vec![9, 14, 17, 19, 21, 23],
        ];
        for (skeleton, chains) in [(Skeleton::smpl24(), smpl.as_slice()), (Skeleton::cmu20(), &[])]
        {
            skeleton.check(Path::new("built in")).unwrap();
            for pair in chains.iter().flat_map(|chain| chain.windows(2)) {
                assert_eq!(skeleton.parents[pair[1]], Some(pair[0]));
            }
        }
    }
}
