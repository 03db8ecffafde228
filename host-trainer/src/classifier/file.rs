//! The classifier as a safetensors file, under the names of Action2Motion's.
//!
//! `recurrent.weight_ih_l{i}` (3 · unit, input), `recurrent.weight_hh_l{i}` (3 · unit, unit), `recurrent.bias_ih_l{i}`,
//! `recurrent.bias_hh_l{i}`, `linear1.weight` (feature, unit), `linear1.bias`, `linear2.weight` (action, feature),
//! `linear2.bias`; in the metadata `classes`, the names of the actions as JSON, and in our own files `description`, the
//! JSON of [`Description`].
//!
//! Why here: the names stay PyTorch's, so that classifiers which others have published and ours are read alike.

use std::fs;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Classifier;
use super::example::Input;
use super::recurrent::GATE_COUNT;
use super::train::Settings;
use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::tensor_file::{TensorReader, TensorWriter};
use crate::error::{Error, Result};
use crate::float_model::DenseLayer;

const REMEDY: &str = "give a file of `host-trainer classify`, or one that Action2Motion's classifier was converted to";

/// Where a classifier of `host-trainer classify` comes from, and what it may be used for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// What it reads.
    pub input: Input,
    /// The joints or channels that it reads, in order.
    pub names: Vec<String>,
    /// Poses per second of its clips.
    pub rate_hz: f64,
    /// How it was trained; `frames` is how many poses of a motion it has to see.
    pub settings: Settings,
    /// SHA-256 of the settings, hexadecimal.
    pub config_hash: String,
    /// SHA-256 of the training clips, hexadecimal.
    pub data_hash: String,
    /// Clips that it learned from.
    pub training_clip_count: usize,
    /// Names of the clips that it did not learn from.
    pub held_out: Vec<String>,
    /// Share of the training clips that it is right about.
    pub training_accuracy: f64,
    /// Of the held-out clips; `None` without any.
    pub held_out_accuracy: Option<f64>,
}

impl Classifier {
    /// Writes the classifier; the same classifier gives the same bytes.
    ///
    /// # Errors
    /// `BadInput` when the file exists and `overwrite` is `Refuse`; `Io` when it cannot be written.
    pub fn save(&self, path: &Path, overwrite: Overwrite) -> Result<()> {
        atomic_file::check(path, overwrite)?;
        let json = |error| unreachable!("plain structs: {error}");
        let mut writer = TensorWriter::default();
        if let Some(actions) = &self.actions {
            writer.metadata("classes", serde_json::to_string(actions).unwrap_or_else(json));
        }
        if let Some(description) = &self.description {
            let text = serde_json::to_string(description).unwrap_or_else(json);
            writer.metadata("description", text);
        }
        for (layer, [weight, bias]) in self.layers.iter().zip(self.tensor_names()) {
            let shape = vec![layer.output_count, layer.input_count];
            writer.floats(weight, shape, &layer.weights);
            writer.floats(bias, vec![layer.output_count], &layer.bias);
        }
        writer.replace(path)
    }

    /// Weight and bias of every layer.
    fn tensor_names(&self) -> impl Iterator<Item = [String; 2]> {
        let recurrent = |index| {
            ["ih", "hh"].map(|half| {
                ["weight", "bias"].map(|what| format!("recurrent.{what}_{half}_l{index}"))
            })
        };
        let ends = ["linear1", "linear2"];
        let ends = ends.map(|name| ["weight", "bias"].map(|what| format!("{name}.{what}")));
        (0..self.recurrent_count()).flat_map(recurrent).chain(ends)
    }

    /// Reads a classifier.
    ///
    /// # Errors
    /// * `Io` when the file cannot be read.
    /// * `BadInput` when it is no safetensors file, lacks a tensor, or holds one of another shape or a number that is
    ///   not finite.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = fs::read(path).map_err(Error::io("read", path))?;
        let reader = TensorReader::parse(&bytes, path, REMEDY)?;
        let layers = read_layers(&reader)?;
        let description = read_optional(&reader, "description")?;
        let classifier = Self { layers, actions: read_optional(&reader, "classes")?, description };
        if let Some(actions) = classifier.actions() {
            let (found, expected) = (actions.len(), classifier.action_count());
            if found != expected {
                let expected = format!("{expected}, as `linear2.weight` has rows");
                return Err(reader.refusal("metadata `classes`, names", found, expected));
            }
        }
        Ok(classifier)
    }
}

fn read_optional<T: DeserializeOwned>(reader: &TensorReader<'_>, key: &str) -> Result<Option<T>> {
    reader.find_metadata(key).map(|_| reader.json(key)).transpose()
}

fn read_layers(reader: &TensorReader<'_>) -> Result<Vec<DenseLayer>> {
    let unit_count = matrix_shape(reader, "recurrent.weight_hh_l0")?[1];
    let mut input_count = matrix_shape(reader, "recurrent.weight_ih_l0")?[1];
    let mut layers = Vec::new();
    let exists = |index: &usize| {
        reader.find_matrix_shape(&format!("recurrent.weight_ih_l{index}")).is_some()
    };
    for index in (0..).take_while(exists) {
        for (half, input_count) in [("ih", input_count), ("hh", unit_count)] {
            let names = ["weight", "bias"].map(|what| format!("recurrent.{what}_{half}_l{index}"));
            layers.push(read_layer(reader, &names, input_count, GATE_COUNT * unit_count)?);
        }
        input_count = unit_count;
    }
    for name in ["linear1", "linear2"] {
        let names = ["weight", "bias"].map(|what| format!("{name}.{what}"));
        let output_count = matrix_shape(reader, &names[0])?[0];
        layers.push(read_layer(reader, &names, input_count, output_count)?);
        input_count = output_count;
    }
    Ok(layers)
}

fn matrix_shape(reader: &TensorReader<'_>, name: &str) -> Result<[usize; 2]> {
    let field = format!("tensor `{name}`");
    match reader.find_matrix_shape(name) {
        Some([0, _] | [_, 0]) => Err(reader.refusal(field, "empty", "a matrix")),
        Some(shape) => Ok(shape),
        None => Err(reader.refusal(field, "missing", "a matrix")),
    }
}

fn read_layer(
    reader: &TensorReader<'_>,
    [weight, bias]: &[String; 2],
    input_count: usize,
    output_count: usize,
) -> Result<DenseLayer> {
    let layer = DenseLayer {
        input_count,
        output_count,
        weights: reader.floats(weight, &[output_count, input_count])?,
        bias: reader.floats(bias, &[output_count])?,
    };
    for (name, values) in [(weight, &layer.weights), (bias, &layer.bias)] {
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            return Err(reader.refusal(format!("tensor `{name}`"), value, "finite numbers"));
        }
    }
    Ok(layer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::tensor_file::TensorWriter;

    type Shapes = Vec<(&'static str, Vec<usize>)>;

    /// A tiny classifier: 3 channels, 2 units, 4 features, 2 actions.
    fn tensors() -> Shapes {
        vec![
            ("recurrent.weight_ih_l0", vec![6, 3]),
            ("recurrent.bias_ih_l0", vec![6]),
            ("recurrent.weight_hh_l0", vec![6, 2]),
            ("recurrent.bias_hh_l0", vec![6]),
            ("recurrent.weight_ih_l1", vec![6, 2]),
            ("recurrent.bias_ih_l1", vec![6]),
            ("recurrent.weight_hh_l1", vec![6, 2]),
            ("recurrent.bias_hh_l1", vec![6]),
            ("linear1.weight", vec![4, 2]),
            ("linear1.bias", vec![4]),
            ("linear2.weight", vec![2, 4]),
            ("linear2.bias", vec![2]),
        ]
    }

    fn load(tensors: &Shapes, value: f32, classes: &str) -> Result<Classifier> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("judge.safetensors");
        let values = [value; 64];
        let mut writer = TensorWriter::default();
        writer.metadata("classes", classes.to_owned());
        for (name, shape) in tensors {
            let len = shape.iter().product::<usize>();
            writer.floats((*name).to_owned(), shape.clone(), &values[..len]);
        }
        writer.replace(&file).unwrap();
        Classifier::load(&file)
    }

    fn refusal(tensors: &Shapes, value: f32, classes: &str) -> String {
        load(tensors, value, classes).map(|_| ()).unwrap_err().to_string()
    }

    const CLASSES: &str = r#"["nod", "wave"]"#;

    #[test]
    fn file_of_another_kind_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("judge.tar");
        fs::write(&file, "not a tensor").unwrap();
        let message = Classifier::load(&file).unwrap_err().to_string();
        assert!(message.contains("judge.tar") && message.contains("safetensors"), "{message}");
        assert!(matches!(Classifier::load(folder.path()), Err(Error::Io { .. })));
    }

    #[test]
    fn missing_tensor_is_refused_by_name() {
        for missing in 0..tensors().len() {
            let mut tensors = tensors();
            let (name, _) = tensors.remove(missing);
            if name == "recurrent.weight_ih_l1" {
                continue; // What is left is a classifier of one layer.
            }
            let message = refusal(&tensors, 0.1, CLASSES);
            assert!(message.contains(name) && message.contains("missing"), "{name}: {message}");
        }
    }

    #[test]
    fn tensor_of_another_shape_is_refused_by_name() {
        for (wrong, (name, shape)) in tensors().into_iter().enumerate() {
            // The first and the last sizes are the file's own to choose.
            let fixed = if shape.len() == 1 || name.starts_with("recurrent") { 0 } else { 1 };
            let mut tensors = tensors();
            tensors[wrong].1[fixed] += 1;
            let message = refusal(&tensors, 0.1, CLASSES);
            assert!(message.contains(name) && message.contains("shape"), "{name}: {message}");
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let message = refusal(&tensors(), f32::NAN, CLASSES);
        assert!(message.contains("NaN") && message.contains("weight_ih_l0"), "{message}");
    }

    #[test]
    fn names_that_do_not_fit_the_logits_are_refused() {
        let message = refusal(&tensors(), 0.1, r#"["nod"]"#);
        assert!(message.contains("names is 1, expected 2"), "{message}");
        assert!(refusal(&tensors(), 0.1, "nod, wave").contains("JSON"));
    }

    #[test]
    fn saved_classifier_comes_back_and_is_never_overwritten_unasked() {
        let classifier = crate::classifier::specimen::classifier(4, 3);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("judge.safetensors");
        classifier.save(&file, Overwrite::Refuse).unwrap();
        assert_eq!(Classifier::load(&file).unwrap(), classifier);
        let message = classifier.save(&file, Overwrite::Refuse).unwrap_err().to_string();
        assert!(message.contains("there already"), "{message}");
        classifier.save(&file, Overwrite::Replace).unwrap();
    }

    #[test]
    fn sizes_and_names_are_the_files_own() {
        let classifier = load(&tensors(), 0.1, CLASSES).unwrap();
        assert_eq!(classifier.channel_count(), 3);
        assert_eq!(classifier.feature_count(), 4);
        assert_eq!(classifier.action_count(), 2);
        assert_eq!(classifier.actions().unwrap(), ["nod", "wave"]);
    }
}
