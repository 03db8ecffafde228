//! The small vocabulary that the tests speak: programs and what they answer, a trained run, goldens, skipping.
//!
//! Why here: a test should read as a sentence and a table; how a process is started is written once.

// With paths, because this folder belongs to the tests: a module beside them would look like one.
#[path = "../core/fuzz/src/checksum.rs"]
mod checksum;
#[path = "support/golden.rs"]
mod golden;
#[path = "support/program.rs"]
mod program;
#[path = "support/trained.rs"]
mod trained;

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

pub use checksum::{CHECKSUM_FIELD, seal};
pub use golden::{GOLDEN_BLOBS, Motion, assert_golden, golden_blob, golden_path, motions};
pub use program::{Outcome, Program, assert_refused, firmware_sim, host_trainer};
pub use trained::{FLOAT_FORMAT, FORMATS, Trained, trained, workplace, workplace_with_phases};

/// Root of the repository.
pub fn repository() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    fs::canonicalize(root).expect("the repository that these tests were compiled in")
}

/// Says, past the test harness's capture, that a test proves nothing on this machine; in continuous integration
/// (`CI` is set) that is a failure.
pub fn skip(reason: &str) {
    assert!(env::var_os("CI").is_none(), "skipping is not allowed where CI is set: {reason}");
    skip_for_lack_of_rights(reason);
}

/// The same where nobody can install what is missing: allowed in continuous integration, too.
pub fn skip_for_lack_of_rights(reason: &str) {
    // The note is a courtesy; without standard error there is nobody to read it.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
}

/// A folder of `shared/data` beside the repository; skips where the data is not.
pub fn shared(name: &str) -> Option<PathBuf> {
    let folder = repository().join("../shared/data").join(name);
    if !folder.is_dir() {
        skip(&format!("{} is not on this machine", folder.display()));
        return None;
    }
    Some(folder)
}

/// Every file that git tracks or would add, with slashes, from the root of the repository.
pub fn repository_files() -> Vec<String> {
    let list = ["ls-files", "--cached", "--others", "--exclude-standard"];
    let output = Command::new("git")
        .args(list)
        .current_dir(repository())
        .output()
        .expect("git is installed");
    assert!(
        output.status.success(),
        "not a git repository: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8(output.stdout).expect("plain file names");
    // A file deleted but not yet committed is still listed.
    text.lines().filter(|path| repository().join(path).exists()).map(str::to_owned).collect()
}

/// A new empty folder that vanishes with its value.
pub fn sandbox() -> TempDir {
    tempfile::Builder::new().prefix("karakuri-").tempdir().expect("a temporary folder")
}

/// Every file below a folder with its bytes, and every folder with none; names relative to the folder.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut waiting = vec![folder.to_path_buf()];
    while let Some(next) = waiting.pop() {
        for entry in fs::read_dir(&next).expect("a readable folder") {
            let path = entry.expect("a readable folder").path();
            let name = path.strip_prefix(folder).expect("inside").to_path_buf();
            let bytes =
                if path.is_dir() { Vec::new() } else { fs::read(&path).expect("a readable file") };
            if path.is_dir() {
                waiting.push(path);
            }
            found.insert(name, bytes);
        }
    }
    found
}
