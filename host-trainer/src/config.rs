//! Every number that decides a training run.
//!
//! In:  a preset (`presets/*.toml`, built in) and the keys that a user's `--config` file overrides.
//! Out: [`TrainConfig`] to `train`, `represent`, `dataset` and the mixture; its hash to every artefact.
//!
//! Why here: the presets carry every key, with unit, meaning and source in a comment, so a key that no preset has is a
//! typing error and is refused.

mod check;

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use toml::{Table, Value};

use crate::dataset::Standardization;
use crate::error::{Error, Result};
use crate::float_model::Modulation;
use crate::mixture::MixtureConfig;
use crate::represent::Representation;

/// Names and texts of the built-in presets.
pub const PRESETS: [(&str, &str); 4] = [
    ("paper", include_str!("../presets/paper.toml")),
    ("published", include_str!("../presets/published.toml")),
    ("small", include_str!("../presets/small.toml")),
    ("tiny", include_str!("../presets/tiny.toml")),
];

/// How squared errors of channels become one loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reduction {
    /// Mean over all channels.
    Channel,
    /// Mean inside each kind of group, summed over the kinds: three channels of translation weigh as much as 144 of
    /// rotation.
    Kind,
}

/// Which parameters a step moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpdateOrder {
    /// Codes and weights together.
    Joint,
    /// A pass over all clips moves the codes, the next one the weights.
    Alternate,
}

/// How often the decoder's weights are moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DecoderStep {
    /// After every batch.
    Batch,
    /// After every pass, by the sum of its batches' gradients.
    Epoch,
}

/// Which code rows an optimiser step moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CodeRows {
    /// Those of the batch.
    Lazy,
    /// All; the others by their momentum.
    Dense,
}

/// How layer 1 sees a clip's code and its action's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CodeComposition {
    /// Side by side, each with weights of its own.
    #[default]
    Concatenate,
    /// Their sum: β is how a clip differs from its action. Kept as two halves of layer 1 with the same weights, so
    /// nothing after training has to know.
    Add,
}

/// Which frames of a clip a batch holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameSampling {
    /// Any, none twice.
    #[default]
    Random,
    /// One from each of equal parts of the clip: less noise in the gradient.
    Spread,
}

/// Course of the learning rates over the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScheduleShape {
    /// Unchanged.
    Constant,
    /// Half a cosine, from the full rate to 0.
    Cosine,
}

macro_rules! section {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type,)* }
    };
}

section! {
    /// Every hyper-parameter of a run.
    TrainConfig {
        /// Start of every random stream.
        seed: u64,
        /// How joints are presented.
        representation: Representation,
        /// How channels are scaled.
        standardization: Standardization,
        /// Share of each action's clips that training does not see. 0 stays out of the canonical text: runs from before
        /// this key held nothing out, and keep their hash.
        #[serde(default, skip_serializing_if = "is_zero")]
        hold_out: f64,
        /// `[decoder]`
        decoder: DecoderConfig,
        /// `[time]`
        time: TimeConfig,
        /// `[codes]`
        codes: CodesConfig,
        /// `[loss]`
        loss: LossConfig,
        /// `[batch]`
        batch: BatchConfig,
        /// `[update]`
        update: UpdateConfig,
        /// `[adam]`
        adam: AdamConfig,
        /// `[schedule]`
        schedule: ScheduleConfig,
        /// `[budget]`
        budget: BudgetConfig,
        /// `[mixture]`
        mixture: MixtureConfig,
    }
}

section! {
    /// Shape of the decoder.
    DecoderConfig {
        /// Units of every hidden layer.
        hidden_widths: Vec<usize>,
        /// What besides layer 1 follows the code. None stays out of the canonical text, as `hold_out` does.
        #[serde(default, skip_serializing_if = "Modulation::is_none")]
        modulation: Modulation,
    }
}

section! {
    /// The time embedding.
    TimeConfig {
        /// Numbers of τ; even.
        sinusoid_count: usize,
        /// `w_k = base^(-2k / sinusoid_count)` radians per frame.
        base: f64,
    }
}

section! {
    /// The code tables.
    CodesConfig {
        /// Numbers of β.
        sequence_dimensions: usize,
        /// Numbers of α.
        action_dimensions: usize,
        /// Natural logarithm of every variance at the start.
        log_variance_start: f64,
        /// Whether β is drawn from its Gaussian and pays for its divergence.
        sequence_variational: bool,
        /// Whether α is drawn from its Gaussian and pays for its divergence.
        action_variational: bool,
        /// How layer 1 sees β and α. Like `action_code`, out of the canonical text at its default, as `hold_out` is.
        #[serde(default, skip_serializing_if = "is_default")]
        compose: CodeComposition,
        /// Whether actions have a code. Without one α stays 0, and β alone tells the actions apart.
        #[serde(default = "yes", skip_serializing_if = "Clone::clone")]
        action_code: bool,
    }
}

section! {
    /// The loss.
    LossConfig {
        /// How squared errors are reduced.
        reduction: Reduction,
        /// Weight of each KL term.
        kl_weight: f64,
    }
}

section! {
    /// Size of a batch.
    BatchConfig {
        /// Clips a step, at most.
        clips: usize,
        /// Frames a clip.
        frames: usize,
        /// Which frames; out of the canonical text at its default, as `hold_out` is.
        #[serde(default, skip_serializing_if = "is_default")]
        sampling: FrameSampling,
    }
}

section! {
    /// What a step moves.
    UpdateConfig {
        /// Codes and weights together or in turn.
        order: UpdateOrder,
        /// How often weights are moved.
        decoder_step: DecoderStep,
        /// Which codes are moved.
        code_rows: CodeRows,
        /// Largest Euclidean norm of the gradient by the decoder, by all β and by all α; 0: no limit.
        gradient_norm_max: f64,
    }
}

section! {
    /// The optimiser.
    AdamConfig {
        /// Learning rate of weights and biases.
        decoder_learning_rate: f64,
        /// Learning rate of means and log-variances.
        code_learning_rate: f64,
        /// Decay of the first moment per step.
        beta1: f64,
        /// Decay of the second moment per step.
        beta2: f64,
        /// Added to the root of the second moment.
        epsilon: f64,
    }
}

section! {
    /// Course of the learning rates.
    ScheduleConfig {
        /// Constant or cosine.
        shape: ScheduleShape,
    }
}

section! {
    /// When training ends.
    BudgetConfig {
        /// Forward and backward passes; counts when `minutes` is 0.
        steps: u64,
        /// Minutes of training, over all resumed runs together; 0: `steps` counts.
        minutes: f64,
    }
}

impl CodesConfig {
    /// Whether β, and whether α, is drawn from its Gaussian.
    pub fn variational(&self) -> [bool; 2] {
        [self.sequence_variational, self.action_variational && self.action_code]
    }
}

impl TrainConfig {
    /// A built-in preset.
    ///
    /// # Errors
    /// `BadInput` when no preset has this name.
    pub fn preset(name: &str) -> Result<Self> {
        Self::from_table(preset_table(name)?, Path::new(name))
    }

    /// A preset, with the keys that the file gives in place of the preset's.
    ///
    /// # Errors
    /// * `Io` when the file cannot be read.
    /// * `BadInput` for a key that does not exist, a value of the wrong type or out of range.
    pub fn preset_with_file(name: &str, file: &Path) -> Result<Self> {
        let text = fs::read_to_string(file).map_err(Error::io("read", file))?;
        let overrides: Table = text.parse().map_err(|error: toml::de::Error| {
            let remedy = "correct the syntax there";
            Error::bad_input(file, "the text", error.to_string().trim_end(), "TOML", remedy)
        })?;
        Self::preset_with_keys(name, overrides, file)
    }

    /// A preset, with these keys in place of its own; `source` is for messages.
    ///
    /// # Errors
    /// `BadInput` as [`TrainConfig::preset_with_file`].
    pub fn preset_with_keys(name: &str, overrides: Table, source: &Path) -> Result<Self> {
        let mut table = preset_table(name)?;
        override_keys(&mut table, overrides, "", source)?;
        Self::from_table(table, source)
    }

    /// Reads what [`TrainConfig::to_toml`] wrote; `source` is for messages.
    ///
    /// # Errors
    /// `BadInput` for anything but a complete and valid configuration.
    pub fn from_toml(text: &str, source: &Path) -> Result<Self> {
        let table = text.parse::<Table>().map_err(|error| incomplete(&error, source))?;
        Self::from_table(table, source)
    }

    /// The canonical text: every key, in fixed order, without comments.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|error| unreachable!("plain numbers: {error}"))
    }

    /// SHA-256 of the canonical text; names the configuration in every artefact.
    pub fn config_hash(&self) -> [u8; 32] {
        Sha256::digest(self.to_toml()).into()
    }

    fn from_table(table: Table, source: &Path) -> Result<Self> {
        let config: Self = table.try_into().map_err(|error| incomplete(&error, source))?;
        config.check(source)?;
        Ok(config)
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// For keys that were `true` before they existed.
fn yes() -> bool {
    true
}

fn preset_table(name: &str) -> Result<Table> {
    let names = PRESETS.map(|(name, _)| name).join(", ");
    let (_, text) = PRESETS.into_iter().find(|(preset, _)| *preset == name).ok_or_else(|| {
        Error::bad_input("--preset", "name", name, &names, "choose one of these names")
    })?;
    text.parse().map_err(|error| incomplete(&error, Path::new(name)))
}

/// Replaces the preset's values by the user's, key by key.
fn override_keys(preset: &mut Table, overrides: Table, section: &str, file: &Path) -> Result<()> {
    for (key, value) in overrides {
        let path = format!("{section}{key}");
        let keys = preset.keys().cloned().collect::<Vec<_>>().join(", ");
        let Some(target) = preset.get_mut(&key) else {
            let remedy = "remove the key or correct its spelling";
            return Err(Error::bad_input(file, path, "no known key", keys, remedy));
        };
        match (target, value) {
            (Value::Table(target), Value::Table(inner)) => {
                override_keys(target, inner, &format!("{path}."), file)?;
            }
            (target @ Value::Float(_), Value::Integer(number)) => {
                *target = Value::Float(number as f64);
            }
            (target, value) if target.same_type(&value) => *target = value,
            (target, value) => {
                let expected = format!("a value of type {}, as {target}", target.type_str());
                return Err(Error::bad_input(file, path, value, expected, "correct the value"));
            }
        }
    }
    Ok(())
}

fn incomplete(error: &toml::de::Error, source: &Path) -> Error {
    let expected = "a complete configuration";
    Error::bad_input(
        source,
        "the configuration",
        error.to_string().trim_end(),
        expected,
        "correct that key",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_file(text: &str) -> Result<TrainConfig> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("own.toml");
        fs::write(&file, text).unwrap();
        TrainConfig::preset_with_file("small", &file)
    }

    #[test]
    fn unknown_preset_is_rejected_with_the_known_names() {
        let message = TrainConfig::preset("huge").unwrap_err().to_string();
        assert!(message.contains("huge") && message.contains("paper, published, small, tiny"));
    }

    #[test]
    fn unknown_key_is_rejected_with_its_path_and_the_known_keys() {
        let message = with_file("[adam]\nbeta3 = 0.5").unwrap_err().to_string();
        assert!(message.contains("own.toml: adam.beta3"), "{message}");
        assert!(message.contains("beta1") && message.contains("spelling"), "{message}");
    }

    #[test]
    fn wrong_type_unknown_word_and_wrong_range_are_rejected_by_key() {
        for (text, word) in [
            ("hold_out = 1", "hold_out"),
            ("hold_out = -0.1", "hold_out"),
            ("hold_out = nan", "hold_out"),
            ("[batch]\nclips = \"many\"", "batch.clips"),
            ("[batch]\nclips = 0", "batch.clips"),
            ("[codes]\ncompose = 'add'\naction_dimensions = 31", "codes.action_dimensions"),
            (
                "[codes]\ncompose = 'add'\naction_dimensions = 32\naction_code = false",
                "codes.action_code",
            ),
            ("[schedule]\nshape = \"linear\"", "linear"),
            ("[adam]\nbeta1 = 1.0", "adam.beta1"),
            ("[time]\nsinusoid_count = 63", "time.sinusoid_count"),
            ("[decoder]\nhidden_widths = []", "decoder.hidden_widths"),
            ("[budget]\nsteps = 0", "budget.steps"),
            ("[budget]\nminutes = nan", "budget.minutes"),
            ("seed = -1", "seed"),
            ("seed = ", "TOML"),
        ] {
            let message = with_file(text).unwrap_err().to_string();
            assert!(message.contains(word) && message.contains("own.toml"), "{text}: {message}");
        }
    }

    #[test]
    fn presets_are_complete_and_survive_their_canonical_text() {
        for (name, _) in PRESETS {
            let config = TrainConfig::preset(name).unwrap();
            let again = TrainConfig::from_toml(&config.to_toml(), Path::new(name)).unwrap();
            assert_eq!(config, again);
            assert_eq!(config.config_hash(), again.config_hash());
        }
    }

    #[test]
    fn hold_out_is_in_the_canonical_text_and_the_hash_unless_it_is_0() {
        let preset = TrainConfig::preset("small").unwrap();
        assert!(!preset.to_toml().contains("hold_out"));
        let holding_out = with_file("hold_out = 0.2").unwrap();
        assert!(holding_out.to_toml().contains("hold_out = 0.2"));
        assert_ne!(holding_out.config_hash(), preset.config_hash());
        let zero = with_file("hold_out = 0").unwrap();
        assert_eq!(zero.config_hash(), preset.config_hash());
    }

    #[test]
    fn keys_that_came_later_leave_the_hash_alone_at_their_defaults() {
        // A preset that has all of them at their defaults.
        let preset = TrainConfig::preset("paper").unwrap();
        let with = |text: String| {
            let keys = text.parse().unwrap();
            TrainConfig::preset_with_keys("paper", keys, Path::new("own.toml")).unwrap()
        };
        for (section, default, other) in [
            ("codes", "compose = 'concatenate'", "compose = 'add'"),
            ("codes", "action_code = true", "action_code = false"),
            ("batch", "sampling = 'random'", "sampling = 'spread'"),
        ] {
            let same = with(format!("[{section}]\n{default}"));
            assert_eq!(same.config_hash(), preset.config_hash(), "{default}");
            let changed = with(format!("[{section}]\n{other}"));
            assert_ne!(changed.config_hash(), preset.config_hash(), "{other}");
            assert!(!preset.to_toml().contains(default.split(' ').next().unwrap()), "{default}");
        }
    }

    #[test]
    fn modulation_is_in_the_canonical_text_and_the_hash_unless_it_is_none() {
        let gated = with_file("[decoder]\nmodulation = \"gates\"").unwrap();
        assert!(gated.to_toml().contains("modulation = \"gates\""));
        let plain = with_file("[decoder]\nmodulation = \"none\"").unwrap();
        assert!(!plain.to_toml().contains("modulation"));
        assert_ne!(gated.config_hash(), plain.config_hash());
        let message = with_file("[decoder]\nmodulation = \"film\"").unwrap_err().to_string();
        assert!(message.contains("gates-and-phases"), "{message}");
    }

    #[test]
    fn every_key_of_every_preset_has_a_comment() {
        for (name, text) in PRESETS {
            for line in text.lines().filter(|line| line.contains(" = ")) {
                assert!(line.contains(" # ") || line.starts_with('#'), "{name}: {line}");
            }
        }
    }

    #[test]
    fn file_overrides_the_preset_and_changes_the_hash() {
        let config = with_file("seed = 9\n[adam]\nbeta1 = 0\n").unwrap();
        let preset = TrainConfig::preset("small").unwrap();
        assert_eq!((config.seed, config.adam.beta1), (9, 0.0));
        assert_eq!(config.decoder, preset.decoder);
        assert_ne!(config.config_hash(), preset.config_hash());
    }
}
