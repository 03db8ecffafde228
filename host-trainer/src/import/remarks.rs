//! What an importer has to say that is not an error, one line per kind rather than one per file.

use std::path::Path;

/// Remarks so far, in the order of their first appearance.
#[derive(Debug, Default)]
pub(crate) struct Remarks(Vec<Remark>);

#[derive(Debug)]
struct Remark {
    what: String,
    count: usize,
    first: String,
}

impl Remarks {
    /// Adds a remark about one file; equal remarks are counted.
    pub fn note(&mut self, file: &Path, what: impl Into<String>) {
        let what = what.into();
        match self.0.iter_mut().find(|remark| remark.what == what) {
            Some(remark) => remark.count += 1,
            None => self.0.push(Remark { what, count: 1, first: file.display().to_string() }),
        }
    }

    /// The text for [`ClipSet::remarks`](crate::clip::ClipSet::remarks).
    pub fn into_lines(self) -> Vec<String> {
        self.0.into_iter().map(Remark::into_line).collect()
    }
}

impl Remark {
    fn into_line(self) -> String {
        let Self { what, count, first } = self;
        match count {
            1 => format!("{first}: {what}"),
            _ => format!("{count} files: {what} (first: {first})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_remarks_become_one_line_with_a_count() {
        let mut remarks = Remarks::default();
        remarks.note(Path::new("a.json"), "resampled");
        remarks.note(Path::new("b.json"), "resampled");
        remarks.note(Path::new("b.json"), "rebased");
        let expected = ["2 files: resampled (first: a.json)", "b.json: rebased"];
        assert_eq!(remarks.into_lines(), expected);
    }
}
