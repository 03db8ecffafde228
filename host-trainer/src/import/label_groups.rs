//! Joins many labels into one action, as a user's TOML file says: `happy = ["cheerful", "laughing"]`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::Remarks;
use crate::error::{Error, Result};

/// Replaces every label by the action that lists it.
pub(crate) fn join(
    path: &Path,
    labels: &mut [Option<String>],
    remarks: &mut Remarks,
) -> Result<()> {
    let actions = read_groups(path)?;
    let used: BTreeSet<&String> = labels.iter().flatten().collect();
    let unknown: Vec<&str> = used
        .iter()
        .filter(|label| !actions.contains_key(**label))
        .map(|label| label.as_str())
        .collect();
    if !unknown.is_empty() {
        let expected = "every label of the clips in one of the groups";
        let remedy = "add them to a group";
        return Err(Error::bad_input(path, "missing labels", unknown.join(", "), expected, remedy));
    }
    for unused in actions.keys().filter(|name| !used.contains(name)) {
        remarks.note(path, format!("label {unused} occurs in no clip"));
    }
    for label in labels.iter_mut().flatten() {
        label.clone_from(&actions[label.as_str()]);
    }
    Ok(())
}

/// Reads label → action.
fn read_groups(path: &Path) -> Result<BTreeMap<String, String>> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    let groups: BTreeMap<String, Vec<String>> = toml::from_str(&text).map_err(|error| {
        let expected = "lines such as happy = [\"cheerful\", \"laughing\"]";
        Error::bad_input(path, "groups", error.message(), expected, "correct the file")
    })?;
    let mut actions = BTreeMap::new();
    for (action, names) in groups {
        for name in names {
            if let Some(first) = actions.insert(name.clone(), action.clone()) {
                let value = format!("in {first} and in {action}");
                return Err(Error::bad_input(path, name, value, "one group", "delete it from one"));
            }
        }
    }
    Ok(actions)
}
