//! The experiments of `reproduce`, which are data: one TOML file a dataset.
//!
//! In:  `experiments/*.toml`, built in, or a file of the user's.
//! Out: [`Experiments`] to `plan`, `stages` and `report`.
//!
//! Why here: what a paper varied, and what it printed, is no code. A key that is not known, a preset or format that
//! does not exist and two rows of one name are refused before anything is trained.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use clap::ValueEnum;
use karakuri::NumberFormat;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::commands::inspect_clips::ImportArgs;
use crate::commands::quantize::FormatArg;
use crate::commands::sampler_args::SamplerArg;
use crate::config::{PRESETS, TrainConfig};
use crate::error::{Error, Result};

/// Names and texts of the built-in experiments.
pub const BUILT_IN: [(&str, &str); 2] = [
    ("humanact12", include_str!("../../experiments/humanact12.toml")),
    ("cmu", include_str!("../../experiments/cmu.toml")),
];

/// All rows of one dataset.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiments {
    /// Heading of the report.
    pub title: String,
    /// Which actions are generated how often.
    pub actions: Shares,
    /// The classifier's hidden state before frame 0.
    pub start: HiddenStart,
    /// Frames of a crop that the classifier sees.
    pub frames: usize,
    /// Column of the labels that holds the classifier's action ids; none when the classifier knows the names.
    pub action_order_column: Option<String>,
    /// Steps of a classifier's training, where none is published for these actions.
    pub classifier_steps: Option<usize>,
    /// What differs from the papers, and why; one sentence each.
    pub differences: Vec<String>,
    /// How clips are read.
    pub import: ImportKeys,
    /// Rows that papers print.
    #[serde(default, rename = "paper")]
    pub papers: Vec<PaperFigures>,
    /// Keys that several rows share, by name.
    #[serde(default, rename = "base")]
    pub bases: BTreeMap<String, Table>,
    /// Our rows.
    #[serde(rename = "row")]
    pub rows: Vec<Experiment>,
}

/// How often each action is generated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shares {
    /// As often as in the data (MotionINR).
    Frequencies,
    /// All alike (ODMO).
    Uniform {
        /// Of every action.
        motions_per_action: usize,
    },
}

/// The classifier's hidden state before frame 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HiddenStart {
    /// Zeros (MotionINR).
    Zeros,
    /// Draws from N(0, 1) (Action2Motion, ACTOR, ODMO).
    Gaussian,
}

/// The flags of reading clips that experiments need; see [`ImportArgs`].
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImportKeys {
    /// `--fps`
    pub fps: Option<f64>,
    /// `--scale`
    pub scale: Option<f64>,
    /// `--label-action-column`
    pub label_action_column: Option<String>,
    /// `--skeleton`
    pub skeleton: Option<String>,
}

/// What a paper prints; what it does not print is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperFigures {
    /// The paper's name of it.
    #[serde(alias = "what")]
    pub name: String,
    /// Fréchet inception distance.
    pub fid: Option<f64>,
    /// Share of motions whose action is recognised.
    pub accuracy: Option<f64>,
    /// Diversity.
    pub diversity: Option<f64>,
    /// Multimodality.
    pub multimodality: Option<f64>,
    /// Mean minimum distance to a real motion's features.
    pub mms: Option<f64>,
    /// Normalised average pairwise distance, per cent.
    pub apd_normalized: Option<f64>,
}

/// One row.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Its name, also that of its folder: letters, digits and dashes.
    pub name: String,
    /// What it is, for the report.
    pub about: String,
    /// The preset to start from.
    pub preset: String,
    /// The name of shared keys that replace the preset's.
    pub base: Option<String>,
    /// Keys that replace the preset's and the shared ones; holds both once the file is read.
    #[serde(default)]
    pub config: Table,
    /// `float`, `w8a16`, `w8a8`, `w4a8`, `f16`; float alone if nothing is said.
    #[serde(default = "float_alone")]
    pub formats: Vec<String>,
    /// How blobs draw codes, as `quantize --sampler` has it.
    pub sampler: Option<String>,
    /// Share of the clips that a second training of the same row does not see, for the held-out figures.
    pub hold_out: Option<f64>,
    /// What the paper prints for the same experiment.
    pub beside: Option<PaperFigures>,
}

/// Where a row's poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// The float model, with the fitted mixture.
    Float,
    /// A blob of this format, with its own sampler, in core's arithmetic.
    Blob(NumberFormat),
}

impl PoseSource {
    /// Name in files and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Float => "float",
            Self::Blob(format) => format.name(),
        }
    }
}

/// Puts keys over others, section by section.
fn put_over(keys: &mut Table, own: Table) {
    for (key, value) in own {
        match (keys.get_mut(&key), value) {
            (Some(Value::Table(section)), Value::Table(own)) => put_over(section, own),
            (_, value) => {
                keys.insert(key, value);
            }
        }
    }
}

fn float_alone() -> Vec<String> {
    vec!["float".into()]
}

impl Experiments {
    /// The built-in experiments of a dataset.
    ///
    /// # Errors
    /// `BadInput` when there are none of this name.
    pub fn built_in(dataset: &str) -> Result<Self> {
        let names = BUILT_IN.map(|(name, _)| name).join(", ");
        let (_, text) =
            BUILT_IN.into_iter().find(|(name, _)| *name == dataset).ok_or_else(|| {
                let remedy = "choose one of these, or bring your own by --experiments";
                Error::bad_input("reproduce", "dataset", dataset, names, remedy)
            })?;
        Self::parse(text, Path::new(dataset))
    }

    /// Experiments of a file.
    ///
    /// # Errors
    /// `Io` when it cannot be read; `BadInput` as [`Experiments::parse`].
    pub fn read(file: &Path) -> Result<Self> {
        let text = fs::read_to_string(file).map_err(Error::io("read", file))?;
        Self::parse(&text, file)
    }

    /// Reads and checks the text of a file; `source` is for messages.
    ///
    /// # Errors
    /// `BadInput` for anything but sound experiments: syntax, an unknown key, preset, format or sampler, a row's name
    /// that is no folder's or stands twice, a share outside 0 to 1.
    pub fn parse(text: &str, source: &Path) -> Result<Self> {
        let mut experiments: Self = toml::from_str(text).map_err(|error| {
            let found = error.to_string().trim_end().replace('\n', " ");
            let remedy = "correct that place; see host-trainer/experiments/humanact12.toml";
            Error::bad_input(source, "the experiments", found, "rows of experiments", remedy)
        })?;
        let is_empty = experiments.actions == Shares::Uniform { motions_per_action: 0 };
        if experiments.rows.is_empty() || experiments.frames == 0 || is_empty {
            let value = format!("{} rows, {} frames", experiments.rows.len(), experiments.frames);
            let remedy = "give at least one [[row]], frames, and motions";
            return Err(Error::bad_input(source, "row", value, "1 or more of each", remedy));
        }
        for row in &mut experiments.rows {
            row.take_base(&experiments.bases, source)?;
        }
        for (index, row) in experiments.rows.iter().enumerate() {
            row.check(source)?;
            if experiments.rows[..index].iter().any(|other| other.name == row.name) {
                let remedy = "give every row a name of its own";
                return Err(Error::bad_input(source, "row.name", &row.name, "a new name", remedy));
            }
        }
        Ok(experiments)
    }

    /// The flags by which the clips are read.
    pub fn import_args(&self) -> ImportArgs {
        ImportArgs {
            rate_hz: self.import.fps,
            scale: self.import.scale,
            label_action_column: self.import.label_action_column.clone(),
            skeleton: self.import.skeleton.clone(),
            ..ImportArgs::default()
        }
    }
}

impl Experiment {
    /// Puts the shared keys under the row's own.
    fn take_base(&mut self, bases: &BTreeMap<String, Table>, source: &Path) -> Result<()> {
        let Some(name) = &self.base else { return Ok(()) };
        let base = bases.get(name).ok_or_else(|| {
            let known = bases.keys().cloned().collect::<Vec<_>>().join(", ");
            let (field, remedy) = (self.field("base"), "name one of these, or add a [base.NAME]");
            Error::bad_input(source, field, name, known, remedy)
        })?;
        let own = std::mem::replace(&mut self.config, base.clone());
        put_over(&mut self.config, own);
        Ok(())
    }

    fn check(&self, source: &Path) -> Result<()> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
        if self.name.is_empty() || !self.name.chars().all(is_plain) {
            let expected = "letters, digits and dashes";
            let remedy = "rename it; a folder is named after it";
            return Err(Error::bad_input(source, "row.name", &self.name, expected, remedy));
        }
        if self.formats.is_empty() {
            let field = self.field("formats");
            return Err(Error::bad_input(source, field, "empty", "one or more", "name a format"));
        }
        if let Some(share) = self.hold_out.filter(|share| !(*share > 0.0 && *share < 1.0)) {
            let field = self.field("hold_out");
            let remedy = "correct it, or remove it to hold nothing out";
            return Err(Error::bad_input(source, field, share, "between 0 and 1", remedy));
        }
        if !PRESETS.iter().any(|(name, _)| *name == self.preset) {
            let names = PRESETS.map(|(name, _)| name).join(", ");
            let (field, remedy) = (self.field("preset"), "choose one of these");
            return Err(Error::bad_input(source, field, &self.preset, names, remedy));
        }
        self.train_config(source)?;
        self.sources(source)?;
        self.sampler(source)?;
        Ok(())
    }

    /// The settings: the preset with the row's keys.
    ///
    /// # Errors
    /// `BadInput` as [`TrainConfig::preset_with_keys`].
    pub fn train_config(&self, source: &Path) -> Result<TrainConfig> {
        let place = format!("{}: row {}", source.display(), self.name);
        TrainConfig::preset_with_keys(&self.preset, self.config.clone(), Path::new(&place))
    }

    /// What is measured, in the file's order.
    ///
    /// # Errors
    /// `BadInput` for a name that is no format's.
    pub fn sources(&self, source: &Path) -> Result<Vec<PoseSource>> {
        let of_name = |name: &String| match name.as_str() {
            "float" => Ok(PoseSource::Float),
            name => FormatArg::from_str(name, false)
                .map(|format| PoseSource::Blob(format.into()))
                .map_err(|_| {
                    let known = NumberFormat::ALL.map(NumberFormat::name).join(", ");
                    let expected = format!("float, {known}");
                    let remedy = "choose among these";
                    Error::bad_input(source, self.field("formats"), name, expected, remedy)
                }),
        };
        self.formats.iter().map(of_name).collect()
    }

    /// How blobs draw codes; as `quantize` does by default if the row says nothing.
    ///
    /// # Errors
    /// `BadInput` for a name that `quantize --sampler` does not know.
    pub fn sampler(&self, source: &Path) -> Result<SamplerArg> {
        let Some(name) = &self.sampler else {
            return Ok(SamplerArg::NearestClips);
        };
        SamplerArg::from_str(name, false).map_err(|_| {
            let known: Vec<String> = SamplerArg::value_variants()
                .iter()
                .filter_map(|sampler| Some(sampler.to_possible_value()?.get_name().to_owned()))
                .collect();
            let (field, known) = (self.field("sampler"), known.join(", "));
            Error::bad_input(source, field, name, known, "choose one of these")
        })
    }

    fn field(&self, key: &str) -> String {
        format!("{key} of row {}", self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "title = 't'\nactions = 'frequencies'\nstart = 'zeros'\nframes = 60\n\
                        differences = []\n[import]\n";

    fn refusal(rows: &str) -> String {
        let text = format!("{HEAD}{rows}");
        Experiments::parse(&text, Path::new("own.toml")).unwrap_err().to_string()
    }

    #[test]
    fn experiments_that_cannot_be_run_are_refused_by_place() {
        let row = "[[row]]\nname = 'a'\nabout = ''\npreset = 'small'\n";
        for (rows, expected) in [
            (String::new(), "row"),
            ("row = []".to_owned(), "row"),
            ("[[row]]\nname = 'a'".to_owned(), "about"),
            (format!("{row}prset = 1"), "prset"),
            (row.replace("small", "smal"), "smal"),
            (row.replace("'a'", "'../a'"), "letters, digits"),
            (format!("{row}formats = ['w9a9']"), "formats of row a is w9a9"),
            (format!("{row}formats = []"), "one or more"),
            (format!("{row}base = 'b'"), "base of row a is b"),
            (format!("{row}sampler = 'dice'"), "clip-codes"),
            (format!("{row}hold_out = 1.0"), "between 0 and 1"),
            (format!("{row}config = {{ batch = {{ clip = 3 }} }}"), "batch.clip"),
            (format!("{row}{row}"), "a new name"),
        ] {
            let error = refusal(&rows);
            assert!(error.contains(expected) && error.contains("own.toml"), "{rows}: {error}");
        }
    }

    #[test]
    fn unknown_dataset_is_refused_with_the_known_ones() {
        let error = Experiments::built_in("humanact13").unwrap_err().to_string();
        assert!(error.contains("humanact13") && error.contains("humanact12, cmu"), "{error}");
    }

    #[test]
    fn built_in_experiments_are_sound() {
        for (name, _) in BUILT_IN {
            let experiments = Experiments::built_in(name).unwrap();
            assert!(experiments.rows.len() >= 4 && experiments.import.fps.is_some());
        }
    }

    #[test]
    fn keys_of_a_row_replace_those_of_its_preset() {
        let text = format!(
            "{HEAD}[base.b]\nmixture = {{ components_max = 9, restarts = 2 }}\n[[row]]\nname = 'a'\nabout = ''\n\
             preset = 'paper'\nbase = 'b'\nformats = ['float', 'w4a8']\nsampler = 'diagonal-mixture'\n\
             config = {{ mixture = {{ components_max = 3 }} }}"
        );
        let source = Path::new("own.toml");
        let row = Experiments::parse(&text, source).unwrap().rows.remove(0);
        let config = row.train_config(source).unwrap();
        assert_eq!((config.mixture.components_max, config.batch.clips), (3, 32));
        assert_eq!(config.mixture.restarts, 2);
        let sources = [PoseSource::Float, PoseSource::Blob(NumberFormat::W4A8)];
        assert_eq!(row.sources(source).unwrap(), sources);
        assert_eq!(row.sampler(source).unwrap(), SamplerArg::DiagonalMixture);
    }
}
