//! Generated poses → files that others read.
//!
//! In:  [`Motion`] from `generate`.
//! Out: CSV (read again by the importer), NumPy, or JSON; each written whole or not at all.

pub mod bvh;
pub mod bvh_servos;

use std::path::{Path, PathBuf};

use npyz::WriterBuilder;
use serde::Serialize;

use crate::atomic_file::{self, Overwrite};
use crate::body::Body;
use crate::body::skeleton::Skeleton;
use crate::error::{Error, Result};
use crate::layout::PoseLayout;

/// One generated motion with everything that is needed to make it again.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Meaning of the channels.
    pub layout: PoseLayout,
    /// The joint tree, if any.
    pub skeleton: Option<Skeleton>,
    /// Poses per second.
    pub rate_hz: f64,
    /// Channel values in channel units. // (frame, channel)
    pub poses: Vec<f32>,
    /// The action that was asked for.
    pub action: String,
    /// The duration that was asked for.
    pub seconds: f64,
    /// The seed that was asked for.
    pub seed: u64,
    /// One line: which model, by which arithmetic.
    pub provenance: String,
}

impl Motion {
    /// Number of poses.
    pub fn frame_count(&self) -> usize {
        self.poses.len() / self.layout.channel_count().max(1)
    }

    /// Pose after pose. // (channel)
    pub fn frames(&self) -> impl Iterator<Item = &[f32]> {
        self.poses.chunks_exact(self.layout.channel_count().max(1))
    }

    /// Joint positions of every pose, or `None` where the layout is not a body. // (frame, joint)
    pub fn joint_positions(&self) -> Option<Vec<Vec<[f64; 3]>>> {
        let body = Body::new(&self.layout, self.skeleton.as_ref())?;
        Some(self.frames().map(|pose| body.joint_positions(pose)).collect())
    }
}

/// File format of generated poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ExportFormat {
    /// One row a pose, time in seconds first, names with units in the header.
    Csv,
    /// f32 (frames, channels); for bodies also (frames, joints, 3) in the folder `joints` beside
    /// it.
    Npy,
    /// Self-describing: layout, skeleton, provenance and poses.
    Json,
    /// Joint hierarchy and Euler angles for animation programs: bodies given by rotations, or servos given by angles.
    Bvh,
}

impl ExportFormat {
    /// The file name extension.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Npy => "npy",
            Self::Json => "json",
            Self::Bvh => "bvh",
        }
    }
}

/// Writes one motion; returns the files that it made, `path` first.
///
/// # Errors
/// - A file exists and `overwrite` is `Refuse`: nothing is written.
/// - The system refuses: an existing file stays as it was.
pub fn write(
    motion: &Motion,
    format: ExportFormat,
    path: &Path,
    overwrite: Overwrite,
) -> Result<Vec<PathBuf>> {
    let files = encode(motion, format, path)?;
    write_files(&files, overwrite)?;
    Ok(files.into_iter().map(|(file, _)| file).collect())
}

/// The files of one motion with their bytes, `path` first; nothing is written yet.
///
/// # Errors
/// The motion does not fit the format.
pub fn encode(
    motion: &Motion,
    format: ExportFormat,
    path: &Path,
) -> Result<Vec<(PathBuf, Vec<u8>)>> {
    let mut files = vec![(path.to_owned(), encode_poses(motion, format, path)?)];
    if let (ExportFormat::Npy, Some(joints)) = (format, motion.joint_positions()) {
        let folder = path.parent().unwrap_or(Path::new("")).join("joints");
        let file = folder.join(path.file_name().unwrap_or_default());
        let bytes = joints_npy(&joints).map_err(Error::io("encode", &file))?;
        files.push((file, bytes));
    }
    Ok(files)
}

/// Writes files, and the last folder of their paths where it is missing. A file that is in the way stops all of them.
///
/// # Errors
/// As [`write`].
pub fn write_files(files: &[(PathBuf, Vec<u8>)], overwrite: Overwrite) -> Result<()> {
    files.iter().try_for_each(|(file, _)| atomic_file::check(file, overwrite))?;
    for (file, bytes) in files {
        let folder =
            file.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.exists());
        if let Some(folder) = folder {
            std::fs::create_dir(folder).map_err(Error::io("create", folder))?;
        }
        atomic_file::write(file, bytes, overwrite)?;
    }
    Ok(())
}

/// The bytes of the file that holds the poses.
///
/// # Errors
/// As [`encode`].
pub fn encode_poses(motion: &Motion, format: ExportFormat, path: &Path) -> Result<Vec<u8>> {
    match format {
        ExportFormat::Csv => Ok(csv(motion).into_bytes()),
        ExportFormat::Npy => {
            let shape = [motion.frame_count() as u64, motion.layout.channel_count() as u64];
            npy(&shape, motion.poses.iter().copied()).map_err(Error::io("encode", path))
        }
        ExportFormat::Json => json(motion).map_err(Error::io("encode", path)),
        ExportFormat::Bvh => bvh_text(motion).map(String::into_bytes).ok_or_else(|| {
            Error::bad_input(
                path,
                "format",
                "bvh",
                "a model of joint rotations with a skeleton, or of servos in degrees or radians",
                "write csv, npy or json, or train with the representation rotations",
            )
        }),
    }
}

fn bvh_text(motion: &Motion) -> Option<String> {
    bvh::emit(motion).or_else(|| bvh_servos::emit(motion))
}

/// Comment lines, a header `time_s,jaw_deg,…`, one row a pose. Numbers have as many digits as give
/// the same f32 back.
fn csv(motion: &Motion) -> String {
    let one_line = |text: &str| text.replace(['\r', '\n'], " ");
    let mut text = format!(
        "# {}\n# action {}, {} s, seed {}, {} Hz\ntime_s,{}\n",
        one_line(&motion.provenance),
        one_line(&motion.action),
        motion.seconds,
        motion.seed,
        motion.rate_hz,
        motion.layout.channel_names().join(",")
    );
    for (frame, pose) in motion.frames().enumerate() {
        let cells: Vec<String> = pose.iter().map(f32::to_string).collect();
        text += &format!("{:.6},{}\n", frame as f64 / motion.rate_hz, cells.join(","));
    }
    text
}

fn npy(shape: &[u64], values: impl Iterator<Item = f32>) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let options = npyz::WriteOptions::new().default_dtype().shape(shape);
    let mut writer = options.writer(&mut bytes).begin_nd()?;
    writer.extend(values)?;
    writer.finish()?;
    Ok(bytes)
}

fn joints_npy(joints: &[Vec<[f64; 3]>]) -> std::io::Result<Vec<u8>> {
    let joint_count = joints.first().map_or(0, Vec::len);
    let values = joints.iter().flatten().flatten().map(|element| *element as f32);
    npy(&[joints.len() as u64, joint_count as u64, 3], values)
}

/// The JSON file; field order is the reading order.
#[derive(Serialize)]
struct MotionFile<'a> {
    format: &'static str,
    version: u32,
    provenance: &'a str,
    action: &'a str,
    seconds: f64,
    seed: u64,
    rate_hz: f64,
    layout: &'a PoseLayout,
    channels: Vec<String>,
    skeleton: Option<&'a Skeleton>,
    poses: Vec<&'a [f32]>,
}

fn json(motion: &Motion) -> std::io::Result<Vec<u8>> {
    let file = MotionFile {
        format: "karakuri-motion",
        version: 1,
        provenance: &motion.provenance,
        action: &motion.action,
        seconds: motion.seconds,
        seed: motion.seed,
        rate_hz: motion.rate_hz,
        layout: &motion.layout,
        channels: motion.layout.channel_names(),
        skeleton: motion.skeleton.as_ref(),
        poses: motion.frames().collect(),
    };
    Ok(serde_json::to_vec(&file)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{Group, GroupKind, Unit};

    fn group(name: &str, kind: GroupKind, unit: Unit) -> Group {
        Group { name: name.to_owned(), kind, unit }
    }

    fn servos() -> Motion {
        let groups = vec![
            group("jaw", GroupKind::Scalar, Unit::Degree),
            group("lid", GroupKind::Scalar, Unit::Microsecond),
        ];
        Motion {
            layout: PoseLayout { groups },
            skeleton: None,
            rate_hz: 50.0,
            poses: vec![0.1, 1500.0, -2.5e-8, 1501.25, 1.0, f32::MAX],
            action: "nod".to_owned(),
            seconds: 0.06,
            seed: u64::MAX,
            provenance: "model.kara, w8a16".to_owned(),
        }
    }

    fn body() -> Motion {
        let groups = vec![
            group("root", GroupKind::Translation, Unit::Metre),
            group("head", GroupKind::Position, Unit::Metre),
        ];
        Motion {
            layout: PoseLayout { groups },
            poses: vec![0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.5, 1.0, 0.0],
            ..servos()
        }
    }

    #[test]
    fn existing_file_is_left_alone_unless_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "mine").unwrap();
        let error = write(&servos(), ExportFormat::Csv, &path, Overwrite::Refuse).unwrap_err();
        assert!(error.to_string().contains("--force"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
        write(&servos(), ExportFormat::Csv, &path, Overwrite::Replace).unwrap();
        assert!(std::fs::read_to_string(&path).unwrap().starts_with("# model.kara"));
    }

    #[test]
    fn existing_joints_file_stops_the_pose_file_too() {
        let folder = tempfile::tempdir().unwrap();
        let joints = folder.path().join("joints");
        std::fs::create_dir(&joints).unwrap();
        std::fs::write(joints.join("a.npy"), "mine").unwrap();
        let path = folder.path().join("a.npy");
        write(&body(), ExportFormat::Npy, &path, Overwrite::Refuse).unwrap_err();
        assert!(!path.exists());
    }

    #[test]
    fn missing_folder_is_an_error_that_names_it() {
        let path = Path::new("/nowhere/at/all/a.csv");
        let error = write(&servos(), ExportFormat::Csv, path, Overwrite::Refuse).unwrap_err();
        assert!(error.to_string().contains("/nowhere/at/all"), "{error}");
    }

    #[test]
    fn csv_names_units_and_keeps_every_bit() {
        let motion = servos();
        let text = csv(&motion);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "# action nod, 0.06 s, seed 18446744073709551615, 50 Hz");
        assert_eq!(lines[2], "time_s,jaw_deg,lid_us");
        let values: Vec<f32> = lines[3..]
            .iter()
            .flat_map(|line| line.split(',').skip(1))
            .map(|cell| cell.parse().unwrap())
            .collect();
        assert_eq!(values, motion.poses);
        assert!(lines[4].starts_with("0.020000,"));
    }

    #[test]
    fn npy_of_a_body_has_channels_and_joints() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let files = write(&body(), ExportFormat::Npy, &path, Overwrite::Refuse).unwrap();
        let shape_and_values = |file: &Path| {
            let bytes = std::fs::read(file).unwrap();
            let npy = npyz::NpyFile::new(&bytes[..]).unwrap();
            (npy.shape().to_vec(), npy.into_vec::<f32>().unwrap())
        };
        assert_eq!(shape_and_values(&files[0]), (vec![2, 6], body().poses));
        let (shape, joints) = shape_and_values(&files[1]);
        assert_eq!(shape, [2, 2, 3]);
        assert_eq!(joints[9..], [1.5, 1.0, 0.0]);
    }

    #[test]
    fn json_describes_itself() {
        let value: serde_json::Value = serde_json::from_slice(&json(&body()).unwrap()).unwrap();
        assert_eq!(value["channels"][3], "head_x_m");
        assert_eq!(value["poses"][1][3], 0.5);
        assert_eq!(value["seed"], u64::MAX);
        assert_eq!(value["layout"]["groups"][0]["kind"], "Translation");
    }
}
