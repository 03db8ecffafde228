//! Station 4: everything that training made, in one file that is replaced atomically.
//!
//! `RUN/checkpoint.safetensors` holds the tensors `decoder.{i}.weight` (out, in), `decoder.{i}.bias` (out),
//! `sequence_code.mean`, `sequence_code.log_variance`, `action_code.mean`, `action_code.log_variance` (row, dimension)
//! and `frequencies_rad` (pair, f64), where there are gates `modulation.0.weight` (row, in) and `modulation.0.bias`,
//! the optimiser's moments under `adam.*`, and in its metadata `config` (TOML), `dataset` (JSON of
//! `DatasetDescription`) and `state` (JSON of [`TrainState`]).
//!
//! Under `adam.first.` and `adam.second.` the names above repeat; `adam.step_count.{decoder,sequence_code,action_code}`
//! (u32, one a row for the tables) count the steps, and `adam.gradient.decoder.*` exists when the configuration sums
//! the decoder's gradient over a pass.
//!
//! Why here: the same training writes the same bytes, so nothing in the file depends on the clock, unless the budget
//! itself is one of minutes.

pub(crate) mod tensor_file;

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::config::{CodeComposition, DecoderStep, TrainConfig};
use crate::dataset::{Dataset, DatasetDescription};
use crate::error::{Error, Result};
use crate::float_model::{CodeTable, DenseLayer, FloatModel, ModelShape, tied_codes};
use crate::random::{Purpose, stream};
use crate::train::optimizer::{CodeMoments, DecoderMoments};
use tensor_file::{TensorReader, TensorWriter};

/// All that a run has learned, and all that it needs to go on.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// The configuration of the run.
    pub config: TrainConfig,
    /// What it was trained on.
    pub dataset: DatasetDescription,
    /// The decoder.
    pub model: FloatModel,
    /// One code a clip.
    pub sequence_codes: CodeTable,
    /// One code an action.
    pub action_codes: CodeTable,
    /// The optimiser's memory.
    pub optimizer: OptimizerState,
    /// How far training has come.
    pub state: TrainState,
}

/// What the optimiser remembers between steps.
#[derive(Clone, Debug, PartialEq)]
pub struct OptimizerState {
    /// Of the decoder.
    pub decoder: DecoderMoments,
    /// Of the clips' codes.
    pub sequence_codes: CodeMoments,
    /// Of the actions' codes.
    pub action_codes: CodeMoments,
    /// The decoder's gradient; lasts from step to step when a pass sums it.
    pub decoder_gradient: Vec<DenseLayer>,
}

/// How far training has come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainState {
    /// Forward and backward passes done.
    pub step: u64,
    /// Seconds of training, for budgets of minutes; 0 for budgets of steps, whose runs end in the same bytes.
    pub elapsed_s: f64,
    /// Whether the budget is used up.
    pub finished: bool,
    /// SHA-256 of the canonical configuration, hexadecimal.
    pub config_hash: String,
    /// SHA-256 of the dataset, hexadecimal.
    pub dataset_hash: String,
    /// Seed of the run.
    pub seed: u64,
    /// What `tune` made of it; `None` for a run of `train`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuning: Option<Tuning>,
}

/// How a checkpoint was tuned for a number format, after its training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tuning {
    /// The format's name; for others the checkpoint is quantised as any other.
    pub format: String,
    /// SHA-256 of the checkpoint file that it began with, hexadecimal.
    pub parent_hash: String,
    /// Seed of the draws.
    pub seed: u64,
    /// Steps asked for.
    pub step_count: u64,
    /// Steps done.
    pub step: u64,
    /// Learning rate of the first step.
    pub learning_rate: f64,
    /// How activations are stored, settled before the first step. // (hidden layer)
    pub activations: Vec<TunedActivation>,
    /// Bits of each layer's weights (code half, time half, the others); empty: those of the format by default.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weight_bits: Vec<u8>,
}

/// See `quantize::layer::InputScale`; an f32, which survives the trip through JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TunedActivation {
    /// Real value of 1.
    pub scale: f32,
    /// Stored value of zero.
    pub zero_point: i16,
}

impl Checkpoint {
    /// Name of the file in a run's folder.
    pub const FILE_NAME: &'static str = "checkpoint.safetensors";

    /// Step 0: random weights, codes at their start.
    pub fn start(dataset: &Dataset, config: &TrainConfig) -> Self {
        let description = &dataset.description;
        let codes = &config.codes;
        let mut rng = stream(config.seed, Purpose::Weights, 0);
        let mut model = FloatModel::random(&model_shape(config, description), &mut rng);
        if codes.compose == CodeComposition::Add {
            tied_codes::tie_start(&mut model);
        }
        if !codes.action_code {
            tied_codes::clear_action_columns(&mut model);
        }
        let start = codes.log_variance_start as f32;
        let sequence_codes =
            CodeTable::constant(description.clips.len(), codes.sequence_dimensions, start);
        let action_codes =
            CodeTable::constant(description.actions.len(), codes.action_dimensions, start);
        Self {
            optimizer: OptimizerState {
                decoder: DecoderMoments::zeros(model.trained_layers()),
                sequence_codes: CodeMoments::zeros(&sequence_codes),
                action_codes: CodeMoments::zeros(&action_codes),
                decoder_gradient: model.trained_layers().map(DenseLayer::zeros_like).collect(),
            },
            state: TrainState {
                step: 0,
                elapsed_s: 0.0,
                finished: false,
                config_hash: hexadecimal(&config.config_hash()),
                dataset_hash: dataset_hash(dataset),
                seed: config.seed,
                tuning: None,
            },
            config: config.clone(),
            dataset: description.clone(),
            model,
            sequence_codes,
            action_codes,
        }
    }

    /// Replaces the checkpoint of a run's folder.
    ///
    /// # Errors
    /// `Io` when writing fails, for example on a full disk; the old checkpoint then stands unharmed.
    pub fn save(&self, run: &Path) -> Result<()> {
        let json = |error| unreachable!("plain structs: {error}");
        let mut writer = TensorWriter::default();
        writer.metadata("config", self.config.to_toml());
        writer.metadata("dataset", serde_json::to_string(&self.dataset).unwrap_or_else(json));
        writer.metadata("state", serde_json::to_string(&self.state).unwrap_or_else(json));
        writer.frequencies("frequencies_rad", &self.model.frequencies_rad);
        let layer_count = self.model.layers.len();
        writer.layers("decoder", &self.model.layers);
        writer.layers("modulation", self.model.modulation.as_slice());
        writer.codes("sequence_code", &self.sequence_codes);
        writer.codes("action_code", &self.action_codes);
        let optimizer = &self.optimizer;
        writer.trained_layers("adam.first", &optimizer.decoder.first, layer_count);
        writer.trained_layers("adam.second", &optimizer.decoder.second, layer_count);
        writer.counts(
            "adam.step_count.decoder",
            core::slice::from_ref(&optimizer.decoder.step_count),
        );
        writer.code_moments("sequence_code", &optimizer.sequence_codes);
        writer.code_moments("action_code", &optimizer.action_codes);
        if self.config.update.decoder_step == DecoderStep::Epoch {
            writer.trained_layers("adam.gradient", &optimizer.decoder_gradient, layer_count);
        }
        writer.replace(&run.join(Self::FILE_NAME))
    }

    /// Reads the checkpoint of a run's folder, or the file itself.
    ///
    /// # Errors
    /// * `Io` when the file cannot be read.
    /// * `BadInput` when it is cut, damaged, or not a checkpoint of this program.
    pub fn load(run: &Path) -> Result<Self> {
        let file = if run.is_dir() { run.join(Self::FILE_NAME) } else { run.to_path_buf() };
        let bytes = fs::read(&file).map_err(Error::io("read", &file))?;
        Self::from_bytes(&bytes, &file)
    }

    fn from_bytes(bytes: &[u8], file: &Path) -> Result<Self> {
        let remedy = "give the folder of a run of this program, or train again";
        let reader = TensorReader::parse(bytes, file, remedy)?;
        let config = TrainConfig::from_toml(reader.metadata("config")?, file)?;
        let dataset: DatasetDescription = reader.json("dataset")?;
        check_description(&dataset, file)?;
        let state: TrainState = reader.json("state")?;
        let shape = model_shape(&config, &dataset);
        let widths = shape.widths();
        let modulation =
            [shape.sequence_code_count + shape.action_code_count, shape.modulation_rows()];
        let modulation = if modulation[1] == 0 { &[][..] } else { &modulation[..] };
        let codes = &config.codes;
        let sequence_shape = [dataset.clips.len(), codes.sequence_dimensions];
        let action_shape = [dataset.actions.len(), codes.action_dimensions];
        let decoder_gradient = match config.update.decoder_step {
            DecoderStep::Epoch => reader.trained_layers("adam.gradient", &widths, modulation)?,
            DecoderStep::Batch => {
                let shapes = widths.windows(2).chain(modulation.windows(2));
                shapes.map(|w| DenseLayer::zeros(w[0], w[1])).collect()
            }
        };
        Ok(Self {
            model: FloatModel {
                sequence_code_count: codes.sequence_dimensions,
                action_code_count: codes.action_dimensions,
                frequencies_rad: reader
                    .frequencies("frequencies_rad", config.time.sinusoid_count / 2)?,
                layers: reader.layers("decoder", &widths)?,
                modulation: reader.layers("modulation", modulation)?.pop(),
            },
            sequence_codes: reader.codes("sequence_code", sequence_shape)?,
            action_codes: reader.codes("action_code", action_shape)?,
            optimizer: OptimizerState {
                decoder: DecoderMoments {
                    first: reader.trained_layers("adam.first", &widths, modulation)?,
                    second: reader.trained_layers("adam.second", &widths, modulation)?,
                    step_count: reader.counts("adam.step_count.decoder", 1)?[0],
                },
                sequence_codes: reader.code_moments("sequence_code", sequence_shape)?,
                action_codes: reader.code_moments("action_code", action_shape)?,
                decoder_gradient,
            },
            config,
            dataset,
            state,
        })
    }

    /// β then α of a clip, by their means. // (β then α)
    pub fn mean_code(&self, clip: usize) -> Vec<f32> {
        let action = self.dataset.clips[clip].action;
        [self.sequence_codes.mean_of(clip), self.action_codes.mean_of(action)].concat()
    }
}

fn model_shape<'a>(config: &'a TrainConfig, dataset: &DatasetDescription) -> ModelShape<'a> {
    ModelShape {
        sequence_code_count: config.codes.sequence_dimensions,
        action_code_count: config.codes.action_dimensions,
        sinusoid_count: config.time.sinusoid_count,
        frequency_base: config.time.base,
        hidden_widths: &config.decoder.hidden_widths,
        channel_count: dataset.layout.channel_count(),
        modulation: config.decoder.modulation,
    }
}

/// Names a dataset: SHA-256 of its description and poses, hexadecimal.
pub fn dataset_hash(dataset: &Dataset) -> String {
    let description = serde_json::to_vec(&dataset.description);
    let mut hash = Sha256::new();
    hash.update(description.unwrap_or_else(|error| unreachable!("plain structs: {error}")));
    for pose in &dataset.poses {
        hash.update(pose.to_le_bytes());
    }
    hexadecimal(&hash.finalize())
}

/// Refuses a description whose parts contradict each other, so that indexing by it cannot fail.
fn check_description(dataset: &DatasetDescription, file: &Path) -> Result<()> {
    let channel_count = dataset.layout.channel_count();
    let mut clips = dataset.clips.iter().chain(&dataset.held_out);
    let lost = clips.find(|clip| clip.action >= dataset.actions.len());
    let complaint = if let Some(clip) = lost {
        Some(("clips", format!("action {} of clip {}", clip.action, clip.name)))
    } else if dataset.mean.len() != channel_count || dataset.scale.len() != channel_count {
        Some(("mean and scale", format!("{} and {}", dataset.mean.len(), dataset.scale.len())))
    } else {
        None
    };
    let Some((field, value)) = complaint else {
        return Ok(());
    };
    let expected = format!("one of {} actions, {channel_count} channels", dataset.actions.len());
    Err(Error::bad_input(file, field, value, expected, "train again; the file was changed"))
}

/// Lower-case hexadecimal digits.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::synthetic::{config, dataset};

    fn saved(overrides: &str) -> (tempfile::TempDir, Checkpoint) {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = Checkpoint::start(&dataset(), &config(overrides));
        checkpoint.save(folder.path()).unwrap();
        (folder, checkpoint)
    }

    #[test]
    fn cut_checkpoint_is_rejected_at_every_length() {
        let (folder, _) = saved("");
        let file = folder.path().join(Checkpoint::FILE_NAME);
        let bytes = fs::read(&file).unwrap();
        for len in (0..bytes.len()).step_by(97).chain([bytes.len() - 1]) {
            fs::write(&file, &bytes[..len]).unwrap();
            let message = Checkpoint::load(folder.path()).unwrap_err().to_string();
            assert!(message.contains("checkpoint.safetensors"), "{len}: {message}");
        }
    }

    #[test]
    fn damaged_header_is_rejected_without_a_panic() {
        let (_folder, checkpoint) = saved("");
        let bytes = fs::read(_folder.path().join(Checkpoint::FILE_NAME)).unwrap();
        let header_len = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        for place in 0..header_len {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x01;
            // Some changes are harmless (a name in the description); none may panic or change a shape.
            if let Ok(loaded) = Checkpoint::from_bytes(&damaged, Path::new("damaged")) {
                assert_eq!(loaded.model.parameter_count(), checkpoint.model.parameter_count());
            }
        }
    }

    #[test]
    fn foreign_file_is_rejected_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("x.safetensors");
        fs::write(&file, b"\x02\0\0\0\0\0\0\0{}").unwrap();
        let message = Checkpoint::load(&file).unwrap_err().to_string();
        assert!(message.contains("config") && message.contains("folder of a run"), "{message}");
        assert!(matches!(Checkpoint::load(&folder.path().join("no")), Err(Error::Io { .. })));
    }

    #[test]
    fn checkpoint_survives_the_file_and_equal_ones_have_equal_bytes() {
        for overrides in ["", "[update]\ndecoder_step = 'epoch'"] {
            let (folder, checkpoint) = saved(overrides);
            assert_eq!(Checkpoint::load(folder.path()).unwrap(), checkpoint);
            let (again, _) = saved(overrides);
            let bytes = |folder: &Path| fs::read(folder.join(Checkpoint::FILE_NAME)).unwrap();
            assert!(bytes(folder.path()) == bytes(again.path()));
        }
    }

    #[test]
    fn unwritable_folder_is_an_error_and_leaves_the_old_checkpoint() {
        let (folder, checkpoint) = saved("");
        // A folder where the unfinished file would go makes its creation fail, as a full disk does.
        fs::create_dir(folder.path().join("checkpoint.safetensors.partial")).unwrap();
        assert!(matches!(checkpoint.save(folder.path()), Err(Error::Io { .. })));
        assert_eq!(Checkpoint::load(folder.path()).unwrap(), checkpoint);
    }
}
