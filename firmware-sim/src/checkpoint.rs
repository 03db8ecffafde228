//! Reads the float model that a training run left behind.
//!
//! In:  `RUN/checkpoint.safetensors`.
//! Out: [`Checkpoint`] to `reference.rs` and `compare.rs`.
//!
//! Why here: a second reader on purpose. The simulator shares no code with the trainer, so a mistake in one is no
//! mistake in the other.
//!
//! Source: the format is described in `host-trainer/src/checkpoint.rs`.

use std::collections::HashMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use karakuri::{GroupKind, Unit};
use safetensors::{Dtype, SafeTensors};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};

/// The file inside a run's folder.
const FILE_NAME: &str = "checkpoint.safetensors";
const REMEDY: &str = "give the folder that `host-trainer train … --out` wrote, or train again";

/// What this crate needs of a training run.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The file, for messages.
    pub path: PathBuf,
    /// SHA-256 of the training configuration, hexadecimal.
    pub config_hash: String,
    /// What it was trained on.
    pub dataset: DatasetDescription,
    /// Layers of the decoder, first to last.
    pub layers: Vec<DenseLayer>,
    /// Gates of the hidden units, layer after layer, then phases of the frequencies; `None` where neither follows the
    /// code.
    pub modulation: Option<DenseLayer>,
    /// β of every clip, the mean. // (clip, dimension)
    pub sequence_codes: Matrix,
    /// α of every action, the mean. // (action, dimension)
    pub action_codes: Matrix,
    /// Angular frequency of each pair of sinusoids, radians per frame. // (pair)
    pub frequencies_rad: Vec<f64>,
}

/// Numbers row after row.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// Numbers of a row.
    pub column_count: usize,
    /// // (row, column)
    pub values: Vec<f64>,
}

impl Matrix {
    /// One row; empty beyond the last.
    pub fn row(&self, index: usize) -> &[f64] {
        let start = index * self.column_count;
        self.values.get(start..start + self.column_count).unwrap_or_default()
    }

    /// The rows, first to last.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.column_count.max(1))
    }
}

/// One fully connected layer.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseLayer {
    /// // (out, in)
    pub weights: Matrix,
    /// // (out)
    pub bias: Vec<f64>,
}

/// The part of the trainer's description of its dataset that matters here.
#[derive(Clone, Debug, Deserialize)]
pub struct DatasetDescription {
    /// Meaning of the channels.
    pub layout: Layout,
    /// Names of the actions.
    pub actions: Vec<String>,
    /// The clips: row i of the sequence codes belongs to clip i.
    pub clips: Vec<ClipDescription>,
    /// Value of each channel that the decoder calls 0. // (channel)
    pub mean: Vec<f64>,
    /// Channel units per 1 of the decoder's output. // (channel)
    pub scale: Vec<f64>,
}

/// All groups of a pose, in channel order.
#[derive(Clone, Debug, Deserialize)]
pub struct Layout {
    /// The groups.
    pub groups: Vec<Group>,
}

/// One named group of channels.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Group {
    /// Unique name: a joint or a servo.
    pub name: String,
    /// What the channels are.
    pub kind: GroupKind,
    /// Unit of every channel of the group.
    pub unit: Unit,
}

/// One clip of the dataset.
#[derive(Clone, Debug, Deserialize)]
pub struct ClipDescription {
    /// The clip's name.
    pub name: String,
    /// Index of its action.
    pub action: usize,
    /// Number of poses.
    pub frame_count: usize,
}

#[derive(Deserialize)]
struct State {
    config_hash: String,
}

impl Checkpoint {
    /// Reads and checks the checkpoint of a run.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::BadInput`] that names the tensor or key that is not as it has to be.
    pub fn read(run: &Path) -> Result<Self> {
        let path = run.join(FILE_NAME);
        let bytes = fs::read(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound => {
                Error::bad_input(run, FILE_NAME, "missing", "a training run", REMEDY)
            }
            _ => Error::io("read", &path)(error),
        })?;
        Source::new(&path, &bytes)?.checkpoint()
    }
}

/// An open checkpoint and its name for messages.
struct Source<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    metadata: HashMap<String, String>,
}

impl<'a> Source<'a> {
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let broken = |error: safetensors::SafeTensorError| {
            let value = format!("{} bytes long and broken ({error})", bytes.len());
            Error::bad_input(path, "file", value, "a complete safetensors file", REMEDY)
        };
        let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let metadata = header.metadata().clone().unwrap_or_default();
        Ok(Self { path, tensors, metadata })
    }

    fn checkpoint(&self) -> Result<Checkpoint> {
        let state: State = self.json("state")?;
        let checkpoint = Checkpoint {
            path: self.path.to_owned(),
            config_hash: state.config_hash,
            dataset: self.json("dataset")?,
            layers: self.layers("decoder")?,
            modulation: self.layers("modulation")?.pop(),
            sequence_codes: self.matrix("sequence_code.mean")?,
            action_codes: self.matrix("action_code.mean")?,
            frequencies_rad: self.numbers("frequencies_rad")?.1,
        };
        self.check_shapes(&checkpoint)?;
        Ok(checkpoint)
    }

    fn json<Value: DeserializeOwned>(&self, key: &str) -> Result<Value> {
        let text = self.metadata.get(key).map_or("missing", String::as_str);
        serde_json::from_str(text).map_err(|error| {
            let field = format!("metadata `{key}`");
            Error::bad_input(self.path, field, error, "JSON of a training run", REMEDY)
        })
    }

    fn layers(&self, prefix: &str) -> Result<Vec<DenseLayer>> {
        let name = |index: usize, part: &str| format!("{prefix}.{index}.{part}");
        (0..)
            .take_while(|&index| self.tensors.tensor(&name(index, "weight")).is_ok())
            .map(|index| {
                let weights = self.matrix(&name(index, "weight"))?;
                let (_, bias) = self.numbers(&name(index, "bias"))?;
                Ok(DenseLayer { weights, bias })
            })
            .collect()
    }

    fn matrix(&self, name: &str) -> Result<Matrix> {
        match self.numbers(name)? {
            (shape, values) if shape.len() == 2 => Ok(Matrix { column_count: shape[1], values }),
            (shape, _) => Err(self.bad(name, format!("of shape {shape:?}"), "two dimensions")),
        }
    }

    /// Shape and values of a tensor of finite f32 or f64.
    fn numbers(&self, name: &str) -> Result<(Vec<usize>, Vec<f64>)> {
        let tensor =
            self.tensors.tensor(name).map_err(|_| self.bad(name, "missing", "a tensor"))?;
        let data = tensor.data();
        let values: Vec<f64> = match tensor.dtype() {
            Dtype::F32 => {
                data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect()
            }
            Dtype::F64 => data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
            other => return Err(self.bad(name, format!("{other:?}"), "f32 or f64")),
        };
        match values.iter().position(|value| !value.is_finite()) {
            Some(index) => Err(self.bad(name, format!("not finite at {index}"), "finite numbers")),
            None => Ok((tensor.shape().to_vec(), values)),
        }
    }

    /// Everything that `reference.rs` multiplies must fit together.
    fn check_shapes(&self, checkpoint: &Checkpoint) -> Result<()> {
        let Checkpoint { dataset, layers, sequence_codes, action_codes, .. } = checkpoint;
        let channel_count: usize =
            dataset.layout.groups.iter().map(|group| group.kind.channel_count()).sum();
        let input_count = sequence_codes.column_count
            + action_codes.column_count
            + 2 * checkpoint.frequencies_rad.len();
        let outputs = layers.iter().map(|layer| layer.bias.len());
        let widths: Vec<usize> = std::iter::once(input_count).chain(outputs).collect();
        for (index, (layer, width)) in layers.iter().zip(&widths).enumerate() {
            let rows = layer.weights.rows().len();
            self.check_count(
                format!("inputs of layer {index}"),
                layer.weights.column_count,
                *width,
            )?;
            self.check_count(format!("biases of layer {index}"), layer.bias.len(), rows)?;
        }
        if let Some(modulation) = &checkpoint.modulation {
            let gates: usize = widths[1..].iter().rev().skip(1).sum();
            let phases = modulation.bias.len().saturating_sub(gates);
            let code_count = sequence_codes.column_count + action_codes.column_count;
            let most = if phases == 0 { 0 } else { checkpoint.frequencies_rad.len() };
            self.check_count("gates and phases", modulation.bias.len(), gates + most)?;
            self.check_count(
                "rows of the modulation",
                modulation.weights.rows().len(),
                gates + most,
            )?;
            self.check_count(
                "inputs of the modulation",
                modulation.weights.column_count,
                code_count,
            )?;
        }
        let last = widths.last().copied().unwrap_or_default();
        self.check_count("layers, at least two", layers.len().min(2), 2)?;
        self.check_count("outputs", last, channel_count)?;
        self.check_count("channel means", dataset.mean.len(), channel_count)?;
        self.check_count("channel scales", dataset.scale.len(), channel_count)?;
        self.check_count("sequence codes", sequence_codes.rows().len(), dataset.clips.len())?;
        self.check_count("action codes", action_codes.rows().len(), dataset.actions.len())?;
        let actions = dataset.clips.iter().map(|clip| clip.action);
        let known = actions.filter(|&action| action < dataset.actions.len()).count();
        self.check_count("clips of a known action", known, dataset.clips.len())
    }

    fn check_count(&self, what: impl ToString, found: usize, expected: usize) -> Result<()> {
        if found == expected { Ok(()) } else { Err(self.bad(what, found, expected)) }
    }

    fn bad(&self, what: impl ToString, value: impl ToString, expected: impl ToString) -> Error {
        Error::bad_input(self.path, what, value, expected, REMEDY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;

    /// The refusal of a run whose checkpoint holds these bytes.
    fn refusal(bytes: &[u8]) -> String {
        let run = tempfile::tempdir().unwrap();
        fs::write(run.path().join(FILE_NAME), bytes).unwrap();
        let error = Checkpoint::read(run.path()).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        error.to_string()
    }

    #[test]
    fn run_without_checkpoint_names_the_missing_file() {
        let error = Checkpoint::read(Path::new("no/such/run")).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        let text = error.to_string();
        assert!(text.contains("no/such/run: checkpoint.safetensors is missing"), "{text}");
    }

    #[test]
    fn checkpoint_cut_at_any_length_is_rejected() {
        let bytes = Fixture::new(1).checkpoint();
        for length in (0..bytes.len()).step_by(97) {
            let text = refusal(&bytes[..length]);
            assert!(text.contains("train again"), "{length}: {text}");
        }
    }

    #[test]
    fn safetensors_of_something_else_name_what_is_missing() {
        let empty =
            safetensors::serialize(Vec::<(&str, safetensors::tensor::TensorView<'_>)>::new(), None);
        let text = refusal(&empty.unwrap());
        assert!(text.contains("metadata `state`"), "{text}");
    }

    #[test]
    fn weight_that_is_no_number_is_rejected() {
        let mut bytes = Fixture::new(1).checkpoint();
        let end = bytes.len();
        // safetensors stores f64 first, f32 last: the file ends with the last f32 tensor.
        bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(refusal(&bytes).contains("not finite"));
    }

    #[test]
    fn checkpoint_is_read_as_it_was_written() {
        let run = Fixture::new(1).run();
        let checkpoint = Checkpoint::read(run.path()).unwrap();
        assert_eq!(checkpoint.layers.len(), 4);
        assert_eq!(checkpoint.frequencies_rad, [0.25, 0.125, 0.0625, 0.03125]);
        assert_eq!(checkpoint.sequence_codes.rows().len(), checkpoint.dataset.clips.len());
    }
}
