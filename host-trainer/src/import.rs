//! Station 1: a user's files → one [`ClipSet`].
//!
//! In:  a clip file, or a folder of clip files of one format.
//! Out: [`ClipSet`] to `represent`, `dataset` and `inspect`.
//!
//! Why here: every format reader answers the same four questions (layout, rate, skeleton, poses);
//! finding files, naming clips, labelling them and checking what all formats must obey is done
//! once, here. One file at a time is in memory beside the result.

use std::path::Path;

use indicatif::{ProgressBar, ProgressFinish, ProgressIterator, ProgressStyle};

use crate::body::skeleton::Skeleton;
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};
use crate::layout::{PoseLayout, Unit};

mod files;
pub mod labels;
mod label_groups;
mod remarks;
mod resample;
mod npy;
mod bvh;
mod reachy;
mod csv_tracks;

#[cfg(test)]
mod support;

use files::ClipFile;
use labels::LabelOptions;
use remarks::Remarks;

/// Fewest poses that are a motion: with one pose there is no speed.
pub const FRAME_COUNT_MIN: usize = 2;

/// A family of clip files that one reader understands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// NumPy arrays: (frames, joints, 3) or (frames, channels).
    Npy,
    /// Biovision hierarchies.
    Bvh,
    /// Reachy Mini recorded moves (JSON).
    Reachy,
    /// Servo tracks as comma-separated values.
    Csv,
}

impl Format {
    /// Every format, in the order in which a folder is searched: a `.json` beside a `.bvh` is a
    /// sidecar.
    pub const ALL: [Self; 4] = [Self::Npy, Self::Bvh, Self::Reachy, Self::Csv];

    /// The extension of the format's files, in lower case.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Npy => "npy",
            Self::Bvh => "bvh",
            Self::Reachy => "json",
            Self::Csv => "csv",
        }
    }
}

/// Everything the user may say about the files that the files do not say themselves.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// The format; `None`: by the extension of the files.
    pub format: Option<Format>,
    /// Where actions come from.
    pub labels: LabelOptions,
    /// Poses per second: of files without time; files with time are resampled to it.
    pub rate_hz: Option<f64>,
    /// Unit of the values in files that do not name it.
    pub unit: Option<Unit>,
    /// Factor on every length (BVH) or every value (npy); `None`: 1.
    pub scale: Option<f64>,
    /// Names of the joints or channels of npy files; empty: `joint00` or `channel00` onwards.
    pub names: Vec<String>,
    /// Let NaN and infinite values through, for `inspect`, which reports them.
    pub tolerate_non_finite: bool,
    /// Let clips without a label through with an empty action, for `inspect`.
    pub tolerate_missing_labels: bool,
}

/// What a format's reader made of the files; poses in the order of the files.
#[derive(Debug)]
pub(crate) struct Recordings {
    pub layout: PoseLayout,
    pub rate_hz: f64,
    pub skeleton: Option<Skeleton>,
    pub poses: Vec<Vec<f32>>, // (file, (frame, channel))
}

/// Reads every clip under `path`.
///
/// # Errors
/// [`Error::BadInput`] naming file, place, value, expectation and remedy; [`Error::Io`] when a file
/// cannot be read.
pub fn read(path: &Path, options: &ImportOptions) -> Result<ClipSet> {
    let mut remarks = Remarks::default();
    let (format, files) = files::find(path, options, &mut remarks)?;
    check_flags(format, options)?;
    let actions = labels::actions(&files, options, &mut remarks)?;
    let recordings = match format {
        Format::Npy => npy::read(&files, options)?,
        Format::Bvh => bvh::read(&files, options, &mut remarks)?,
        Format::Reachy => reachy::read(&files, options, &mut remarks)?,
        Format::Csv => csv_tracks::read(&files, options, &mut remarks)?,
    };
    let clips = files
        .into_iter()
        .zip(actions)
        .zip(recordings.poses)
        .map(|((file, action), poses)| Clip { name: file.name, action, source: file.path, poses })
        .collect();
    Ok(ClipSet {
        layout: recordings.layout,
        rate_hz: recordings.rate_hz,
        skeleton: recordings.skeleton,
        clips,
        remarks: remarks.into_lines(),
    })
}

/// Refuses flags that the format would silently ignore, and values that no file could mean.
fn check_flags(format: Format, options: &ImportOptions) -> Result<()> {
    let is_npy = format == Format::Npy;
    let has_free_lengths = is_npy || format == Format::Bvh;
    let unused = [
        ("--unit", options.unit.is_some() && !has_free_lengths),
        ("--scale", options.scale.is_some() && !has_free_lengths),
        ("--names", !options.names.is_empty() && !is_npy),
    ];
    if let Some((flag, _)) = unused.iter().find(|(_, is_unused)| *is_unused) {
        let value = format!("given for {} files", format.extension());
        let expected = "absence: these files say it themselves";
        return Err(Error::bad_input(flag, "flag", value, expected, "leave it out"));
    }
    if let Some(rate_hz) = options.rate_hz {
        check_rate(Path::new("--fps"), rate_hz)?;
    }
    if let Some(scale) = options.scale.filter(|scale| !scale.is_normal()) {
        let expected = "a finite factor other than 0";
        return Err(Error::bad_input("--scale", "factor", scale, expected, "correct it"));
    }
    Ok(())
}

/// Rates that a motion of a body can have, poses per second; wider than any recorder known to us.
pub const RATE_HZ_RANGE: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

/// Refuses a rate outside [`RATE_HZ_RANGE`], wherever it came from.
pub(crate) fn check_rate(source: &Path, rate_hz: f64) -> Result<()> {
    if RATE_HZ_RANGE.contains(&rate_hz) {
        return Ok(());
    }
    let expected = format!("{RATE_HZ_RANGE:?} poses per second");
    let remedy = "correct the rate or the times";
    Err(Error::bad_input(source, "rate", rate_hz, expected, remedy))
}

/// Every unit, in the order of help texts.
pub const UNITS: [Unit; 7] = [
    Unit::One,
    Unit::Radian,
    Unit::Degree,
    Unit::Metre,
    Unit::Centimetre,
    Unit::Millimetre,
    Unit::Microsecond,
];

/// The unit that `suffix` names in flags and column headers.
pub fn unit_of_suffix(suffix: &str) -> Option<Unit> {
    UNITS.into_iter().find(|unit| unit.suffix() == suffix)
}

/// Walks the files with a progress bar on stderr that vanishes at the end.
pub(crate) fn with_progress(files: &[ClipFile]) -> impl Iterator<Item = &ClipFile> {
    let style = ProgressStyle::with_template("reading {wide_bar} {pos}/{len} files, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(files.len() as u64)
        .with_style(style)
        .with_finish(ProgressFinish::AndClear);
    files.iter().progress_with(bar)
}

/// Checks what every clip must obey: at least [`FRAME_COUNT_MIN`] poses, every value finite.
pub(crate) fn check_poses(
    file: &Path,
    layout: &PoseLayout,
    poses: &[f32],
    options: &ImportOptions,
) -> Result<()> {
    let channel_count = layout.channel_count();
    let frame_count = poses.len() / channel_count.max(1);
    if frame_count < FRAME_COUNT_MIN {
        let expected = format!("at least {FRAME_COUNT_MIN} frames");
        let remedy = "remove the file or record a longer clip";
        return Err(Error::bad_input(file, "length", frames(frame_count), expected, remedy));
    }
    let bad = poses.iter().position(|value| !value.is_finite());
    match bad.filter(|_| !options.tolerate_non_finite) {
        None => Ok(()),
        Some(index) => {
            let channel = &layout.channel_names()[index % channel_count];
            let field = format!("frame {}, {channel}", index / channel_count);
            let remedy = "repair or remove the clip; `inspect` lists every such value";
            Err(Error::bad_input(file, field, poses[index], "a finite number", remedy))
        }
    }
}

fn frames(count: usize) -> String {
    match count {
        1 => "1 frame".into(),
        _ => format!("{count} frames"),
    }
}

#[cfg(test)]
mod tests {
    use super::support::{assert_refused, folder, npy_f32, shared};
    use super::*;

    fn frame_count(set: &ClipSet) -> usize {
        set.clips.iter().map(|clip| clip.frame_count(&set.layout)).sum()
    }

    #[test]
    fn flags_that_the_format_would_ignore_are_refused() {
        let folder = folder(&[("walk.csv", b"time_s,jaw_deg\n0,1\n0.1,2\n")]);
        let options = ImportOptions { unit: Some(Unit::Degree), ..Default::default() };
        assert_refused(read(folder.path(), &options), &["--unit", "csv", "leave it out"]);
        let options = ImportOptions { scale: Some(0.5), ..Default::default() };
        assert_refused(read(folder.path(), &options), &["--scale", "csv"]);
        let options = ImportOptions { names: vec!["jaw".into()], ..Default::default() };
        assert_refused(read(folder.path(), &options), &["--names", "csv"]);
    }

    #[test]
    fn rates_and_scales_that_nothing_can_have_are_refused() {
        let folder = folder(&[("walk.npy", &npy_f32("(2, 1)", &[0.0, 1.0]))]);
        for rate_hz in [f64::NAN, 0.0, -20.0, 1e9] {
            let options = ImportOptions { rate_hz: Some(rate_hz), ..Default::default() };
            assert_refused(read(folder.path(), &options), &["--fps", "1.0..=1000.0"]);
        }
        for scale in [f64::NAN, 0.0, f64::INFINITY] {
            let options = ImportOptions { scale: Some(scale), ..Default::default() };
            assert_refused(read(folder.path(), &options), &["--scale", "finite factor"]);
        }
    }

    #[test]
    fn clips_actions_and_sources_stay_together() {
        let folder =
            folder(&[("wave/1.csv", b"jaw_deg\n1\n2\n"), ("nod/1.csv", b"jaw_deg\n3\n4\n")]);
        let options = ImportOptions { rate_hz: Some(50.0), ..Default::default() };
        let set = read(folder.path(), &options).unwrap();
        let seen: Vec<_> = set
            .clips
            .iter()
            .map(|clip| (clip.name.as_str(), clip.action.as_str(), clip.poses[0]))
            .collect();
        assert_eq!(seen, [("nod/1", "nod", 3.0), ("wave/1", "wave", 1.0)]);
        assert!(set.clips[0].source.ends_with("nod/1.csv"));
    }

    #[test]
    fn humanact12_is_read_whole() {
        let Some(path) = shared("humanact12") else {
            return;
        };
        let mut options = ImportOptions { rate_hz: Some(20.0), ..Default::default() };
        options.labels.action_column = Some("coarse".into());
        let set = read(&path, &options).unwrap();
        assert_eq!((set.clips.len(), frame_count(&set)), (1191, 90_099));
        assert_eq!(set.layout.channel_count(), 72);
        assert_eq!(set.remarks, Vec::<String>::new());
    }

    #[test]
    fn cmu_clips_are_read_whole() {
        let Some(path) = shared("cmu_mocap") else {
            return;
        };
        let options =
            ImportOptions { rate_hz: Some(12.0), scale: Some(0.05), ..Default::default() };
        let set = read(&path, &options).unwrap();
        assert_eq!((set.clips.len(), frame_count(&set)), (970, 185_958));
        assert_eq!(set.remarks, Vec::<String>::new());
    }

    #[test]
    fn reachy_moves_are_read_whole() {
        let Some(path) = shared("reachy_mini_emotions") else {
            return;
        };
        let set = read(&path, &ImportOptions::default()).unwrap();
        assert_eq!((set.clips.len(), frame_count(&set)), (81, 23_162));
        assert_eq!((set.rate_hz, set.layout.channel_count()), (50.0, 12));
        assert_eq!(set.remarks, Vec::<String>::new());
    }

    #[test]
    fn our_groups_join_every_reachy_move_into_ten_emotions() {
        let Some(path) = shared("reachy_mini_emotions") else {
            return;
        };
        let groups = concat!(env!("CARGO_MANIFEST_DIR"), "/label-groups/reachy_emotions.toml");
        let mut options = ImportOptions::default();
        options.labels.groups = Some(groups.into());
        let set = read(&path, &options).unwrap();
        let actions: std::collections::BTreeSet<_> =
            set.clips.iter().map(|clip| clip.action.as_str()).collect();
        assert_eq!((set.clips.len(), actions.len()), (81, 10));
        assert_eq!(set.remarks, Vec::<String>::new());
    }

    #[test]
    fn bandai_hierarchies_are_read_whole() {
        let Some(path) = shared("bandai_namco_bvh") else {
            return;
        };
        let labels = LabelOptions::default().with_pattern(r"^dataset-\d_([a-z-]+)_").unwrap();
        let options = ImportOptions { labels, ..Default::default() };
        let set = read(&path, &options).unwrap();
        assert_eq!((set.clips.len(), frame_count(&set), set.rate_hz), (60, 8_765, 30.0));
        // One root translation and 21 rotations: the still joint above the hips is folded away.
        assert_eq!(set.layout.channel_count(), 3 + 21 * 6);
        assert_eq!(set.skeleton.unwrap().names[0], "Hips");
    }
}
