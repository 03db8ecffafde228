//! `host-trainer character`: writes the built-in character's clips as files, to look at, to edit,
//! to import again.
//!
//! In:  seed and count.
//! Out: a folder of CSV servo tracks, `<action>/<action>_03.csv`, as `import` reads them.
//!
//! Why here: the built-in data takes the same road as a user's own.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write as _};
use std::path::{Path, PathBuf};

use crate::character::{
    CLIPS_PER_ACTION_MAX, DEFAULT_CLIPS_PER_ACTION, DEFAULT_SEED, GENERATOR_VERSION, JOINT_COUNT,
    NAME, RATE_HZ, action_labels, clip_set,
};
use crate::clip::{Clip, ClipSet};
use crate::error::{Error, Result};

/// What every file begins with; how `--force` tells its own files from a user's.
const SIGNATURE: &str = "# karakuri character";

/// Writes the built-in character's clips as CSV servo tracks.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  host-trainer character --out clips --clips-per-action 12")]
pub struct CharacterArgs {
    /// Folder to make for the clips
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The same seed gives the same clips on every machine
    #[arg(long, default_value_t = DEFAULT_SEED)]
    pub seed: u64,
    /// Clips of each action
    #[arg(long, value_name = "N", default_value_t = DEFAULT_CLIPS_PER_ACTION)]
    pub clips_per_action: usize,
    /// Replace a folder that this command made earlier
    #[arg(long)]
    pub force: bool,
}

/// Runs the command: either all clips are there afterwards, or nothing has changed.
///
/// # Errors
/// * [`Error::BadInput`]: no clips or too many asked for; `out` exists and must not be replaced.
/// * [`Error::Io`]: the folder cannot be written.
pub fn run(args: &CharacterArgs) -> Result<()> {
    if !(1..=CLIPS_PER_ACTION_MAX).contains(&args.clips_per_action) {
        return Err(Error::bad_input(
            "command line",
            "--clips-per-action",
            args.clips_per_action,
            format!("1 to {CLIPS_PER_ACTION_MAX}"),
            format!("leave it out for {DEFAULT_CLIPS_PER_ACTION}"),
        ));
    }
    check_out(&args.out, args.force)?;
    let set = clip_set(args.seed, args.clips_per_action);
    write_folder(&args.out, &set, args.seed)?;
    let frame_count = set.clips.iter().map(|clip| clip.frame_count(&set.layout));
    println!(
        "{}: {} clips of {} actions, {:.0} s at {RATE_HZ} Hz, seed {}",
        args.out.display(),
        set.clips.len(),
        action_labels().count(),
        frame_count.sum::<usize>() as f64 / RATE_HZ,
        args.seed,
    );
    Ok(())
}

/// Passes a path where nothing is, and with `force` a folder with nothing in it but files of this
/// command.
fn check_out(out: &Path, force: bool) -> Result<()> {
    let refuse = |place: &Path, value: &str, remedy: &str| {
        let expected = "a folder that does not exist yet";
        Err(Error::bad_input(place, "--out", value, expected, remedy))
    };
    let Ok(metadata) = fs::symlink_metadata(out) else {
        return Ok(());
    };
    if !metadata.is_dir() {
        return refuse(out, "not a folder", "choose another --out");
    }
    if !force {
        let remedy = "choose another --out, or replace it with --force";
        return refuse(out, "already there", remedy);
    }
    for folder in entries(out)? {
        let foreign = if folder.is_dir() {
            entries(&folder)?.into_iter().find(|file| !is_ours(file))
        } else {
            Some(folder)
        };
        if let Some(foreign) = foreign {
            let remedy = "--force replaces only what this command wrote; choose another --out";
            return refuse(&foreign, "a file of someone else", remedy);
        }
    }
    Ok(())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let list = fs::read_dir(folder).and_then(|list| list.map(|e| Ok(e?.path())).collect());
    list.map_err(Error::io("read", folder))
}

/// A file that cannot be read is not ours.
fn is_ours(path: &Path) -> bool {
    let mut line = String::new();
    File::open(path)
        .and_then(|file| BufReader::new(file).read_line(&mut line))
        .is_ok_and(|_| line.starts_with(SIGNATURE))
}

/// Writes everything beside `out` first and renames it into place.
pub fn write_folder(out: &Path, set: &ClipSet, seed: u64) -> Result<()> {
    let parent = match out.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(Error::io("create", parent))?;
    let workshop = tempfile::Builder::new()
        .prefix(".character-")
        .tempdir_in(parent)
        .map_err(Error::io("create a folder in", parent))?;

    let fresh = workshop.path().join("fresh");
    for label in action_labels() {
        let folder = fresh.join(label);
        fs::create_dir_all(&folder).map_err(Error::io("create", folder))?;
    }
    for clip in &set.clips {
        let path = fresh.join(&clip.action).join(format!("{}.csv", clip.name));
        write_file(&path, &csv_text(set, clip, seed)).map_err(Error::io("write", path))?;
    }
    for folder in entries(&fresh)?.iter().chain([&fresh]) {
        sync(folder)?;
    }
    let replaced = workshop.path().join("replaced");
    if out.exists() {
        fs::rename(out, &replaced).map_err(Error::io("move away", out))?;
    }
    fs::rename(&fresh, out).map_err(Error::io("create", out))?;
    sync(parent)
}

fn write_file(path: &Path, text: &str) -> std::io::Result<()> {
    let mut file = File::create_new(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// Makes a folder's entries survive a power cut.
fn sync(folder: &Path) -> Result<()> {
    let synced = File::open(folder).and_then(|file| file.sync_all());
    synced.map_err(Error::io("write", folder))
}

/// One clip as a CSV servo track. Values are whole hundredths, so two digits hold them exactly.
fn csv_text(set: &ClipSet, clip: &Clip, seed: u64) -> String {
    let mut text = format!(
        "{SIGNATURE} {NAME}, generator {GENERATOR_VERSION}, seed {seed}\n\
         # clip {}, {RATE_HZ} Hz; made by `host-trainer character`, free under MIT OR Apache-2.0\n\
         time_s,{}\n",
        clip.name,
        set.layout.channel_names().join(","),
    );
    for (frame, pose) in clip.poses.chunks(JOINT_COUNT).enumerate() {
        // Writing to a String cannot fail.
        let _ = write!(text, "{:.2}", frame as f64 / RATE_HZ);
        for angle_deg in pose {
            let _ = write!(text, ",{angle_deg:.2}");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(out: PathBuf) -> CharacterArgs {
        CharacterArgs { out, seed: 5, clips_per_action: 2, force: false }
    }

    fn sandbox() -> tempfile::TempDir {
        tempfile::tempdir().expect("a temporary folder")
    }

    /// All files below a folder with their text, sorted.
    fn files(folder: &Path) -> Vec<(PathBuf, String)> {
        let mut found = Vec::new();
        for path in entries(folder).expect("a readable folder") {
            if path.is_dir() {
                found.extend(files(&path));
            } else {
                let text = fs::read_to_string(&path).expect("a text file");
                found.push((path, text));
            }
        }
        found.sort();
        found
    }

    fn refusal(args: &CharacterArgs) -> String {
        match run(args) {
            Err(error @ Error::BadInput { .. }) => error.to_string(),
            other => panic!("expected bad input, not {other:?}"),
        }
    }

    #[test]
    fn no_clips_and_far_too_many_are_refused_and_nothing_is_written() {
        let sandbox = sandbox();
        for clips_per_action in [0, CLIPS_PER_ACTION_MAX + 1] {
            let refusal =
                refusal(&CharacterArgs { clips_per_action, ..args(sandbox.path().join("clips")) });
            assert!(refusal.contains("--clips-per-action"), "{refusal}");
            assert!(refusal.contains("1 to 1000"), "{refusal}");
        }
        assert!(files(sandbox.path()).is_empty());
    }

    #[test]
    fn an_existing_folder_is_refused_and_left_alone() {
        let sandbox = sandbox();
        fs::write(sandbox.path().join("thesis.txt"), "years of work").expect("write");
        let refusal = refusal(&args(sandbox.path().to_owned()));
        assert!(refusal.contains("already there"), "{refusal}");
        assert!(refusal.contains("--force"), "{refusal}");
        assert_eq!(files(sandbox.path()).len(), 1);
    }

    #[test]
    fn a_file_in_the_way_is_refused_even_with_force() {
        let sandbox = sandbox();
        let out = sandbox.path().join("clips");
        fs::write(&out, "years of work").expect("write");
        let refusal = refusal(&CharacterArgs { force: true, ..args(out.clone()) });
        assert!(refusal.contains("not a folder"), "{refusal}");
        assert_eq!(fs::read_to_string(out).expect("still there"), "years of work");
    }

    #[test]
    fn force_refuses_a_folder_with_a_file_of_someone_else() {
        let sandbox = sandbox();
        let args = CharacterArgs { force: true, ..args(sandbox.path().join("clips")) };
        run(&args).expect("a first run");
        let foreign = args.out.join("nod").join("mine.csv");
        fs::write(&foreign, "time_s,a_deg\n0,1\n").expect("write");
        let before = files(&args.out);
        let refusal = refusal(&args);
        assert!(refusal.contains("mine.csv"), "{refusal}");
        assert_eq!(files(&args.out), before);
    }

    #[cfg(unix)]
    #[test]
    fn force_does_not_follow_a_link() {
        let sandbox = sandbox();
        let target = sandbox.path().join("target");
        run(&args(target.clone())).expect("a first run");
        let before = files(&target);
        let link = sandbox.path().join("link");
        std::os::unix::fs::symlink(&target, &link).expect("a link");
        refusal(&CharacterArgs { force: true, seed: 6, ..args(link) });
        assert_eq!(files(&target), before);
    }

    #[test]
    fn force_replaces_its_own_folder_with_none_of_the_old_clips_left() {
        let sandbox = sandbox();
        let args = args(sandbox.path().join("new/clips"));
        run(&CharacterArgs { clips_per_action: 3, ..args.clone() }).expect("a first run");
        run(&CharacterArgs { force: true, ..args.clone() }).expect("a second run");
        assert_eq!(files(&args.out).len(), 2 * action_labels().count());
        assert_eq!(entries(&sandbox.path().join("new")).expect("read").len(), 1);
    }

    #[test]
    fn files_hold_the_clips_exactly() {
        let sandbox = sandbox();
        let args = args(sandbox.path().join("clips"));
        run(&args).expect("a run");
        let set = clip_set(args.seed, args.clips_per_action);
        for clip in &set.clips {
            let path = args.out.join(format!("{}/{}.csv", clip.action, clip.name));
            let text = fs::read_to_string(path).expect("a file a clip");
            let mut lines = text.lines().skip_while(|line| line.starts_with('#'));
            let header = lines.next().expect("a header");
            assert!(header.starts_with("time_s,body_yaw_deg,"), "{header}");
            let mut poses = Vec::new();
            for (frame, line) in lines.enumerate() {
                let mut fields = line.split(',').map(|field| field.parse::<f32>());
                let time_s = fields.next().expect("a time").expect("a number");
                assert_eq!(time_s, frame as f32 / RATE_HZ as f32);
                poses.extend(fields.map(|angle| angle.expect("a number")));
            }
            assert_eq!(poses, clip.poses, "{}", clip.name);
        }
    }

    #[test]
    fn every_file_names_its_generator_and_seed() {
        let sandbox = sandbox();
        let args = args(sandbox.path().join("clips"));
        run(&args).expect("a run");
        for (path, text) in files(&args.out) {
            let first = text.lines().next().unwrap_or_default();
            let expected = format!("{SIGNATURE} {NAME}, generator {GENERATOR_VERSION}, seed 5");
            assert_eq!(first, expected, "{}", path.display());
        }
    }
}
