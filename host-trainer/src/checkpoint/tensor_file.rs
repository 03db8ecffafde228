//! Reading and writing of safetensors files.
//!
//! Why here: reading is the library's; writing is ours, because the library orders the metadata at random and the same
//! training has to give the same bytes.
//!
//! Source: the safetensors format: u64 length of the header, JSON header, tensors back to back; little endian.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::atomic_file;
use crate::error::{Error, Result};
use crate::float_model::{CodeTable, DenseLayer};
use crate::train::optimizer::CodeMoments;

/// Values of one tensor, borrowed.
#[derive(Clone, Copy)]
enum Values<'a> {
    F32(&'a [f32]),
    F64(&'a [f64]),
    U32(&'a [u32]),
}

impl Values<'_> {
    fn len_bytes(self) -> usize {
        match self {
            Self::F32(values) => 4 * values.len(),
            Self::F64(values) => 8 * values.len(),
            Self::U32(values) => 4 * values.len(),
        }
    }

    fn dtype(self) -> &'static str {
        match self {
            Self::F32(_) => "F32",
            Self::F64(_) => "F64",
            Self::U32(_) => "U32",
        }
    }

    fn write(self, file: &mut BufWriter<File>) -> std::io::Result<()> {
        match self {
            Self::F32(values) => values.iter().try_for_each(|v| file.write_all(&v.to_le_bytes())),
            Self::F64(values) => values.iter().try_for_each(|v| file.write_all(&v.to_le_bytes())),
            Self::U32(values) => values.iter().try_for_each(|v| file.write_all(&v.to_le_bytes())),
        }
    }
}

/// Collects tensors, then writes them in a fixed order.
#[derive(Default)]
pub(crate) struct TensorWriter<'a> {
    metadata: BTreeMap<&'static str, String>,
    tensors: Vec<(String, Vec<usize>, Values<'a>)>,
}

impl<'a> TensorWriter<'a> {
    pub fn metadata(&mut self, key: &'static str, text: String) {
        self.metadata.insert(key, text);
    }

    pub fn frequencies(&mut self, name: &str, values: &'a [f64]) {
        self.tensors.push((name.to_owned(), vec![values.len()], Values::F64(values)));
    }

    pub fn counts(&mut self, name: &str, values: &'a [u32]) {
        self.tensors.push((name.to_owned(), vec![values.len()], Values::U32(values)));
    }

    pub fn layers(&mut self, prefix: &str, layers: &'a [DenseLayer]) {
        for (index, layer) in layers.iter().enumerate() {
            let shape = vec![layer.output_count, layer.input_count];
            self.floats(format!("{prefix}.{index}.weight"), shape, &layer.weights);
            self.floats(format!("{prefix}.{index}.bias"), vec![layer.output_count], &layer.bias);
        }
    }

    /// `all`: the decoder's `layer_count` layers, then that of gates and phases, if any.
    pub fn trained_layers(&mut self, prefix: &str, all: &'a [DenseLayer], layer_count: usize) {
        self.layers(&format!("{prefix}.decoder"), &all[..layer_count]);
        self.layers(&format!("{prefix}.modulation"), &all[layer_count..]);
    }

    pub fn codes(&mut self, prefix: &str, table: &'a CodeTable) {
        let shape = vec![table.row_count(), table.dimension_count];
        self.floats(format!("{prefix}.mean"), shape.clone(), &table.mean);
        self.floats(format!("{prefix}.log_variance"), shape, &table.log_variance);
    }

    pub fn code_moments(&mut self, name: &str, moments: &'a CodeMoments) {
        self.codes(&format!("adam.first.{name}"), &moments.first);
        self.codes(&format!("adam.second.{name}"), &moments.second);
        self.counts(&format!("adam.step_count.{name}"), &moments.step_counts);
    }

    pub fn floats(&mut self, name: String, shape: Vec<usize>, values: &'a [f32]) {
        self.tensors.push((name, shape, Values::F32(values)));
    }

    /// Writes the file; the f64 tensors come first, so that every tensor is aligned.
    pub fn replace(mut self, path: &Path) -> Result<()> {
        self.tensors.sort_by_key(|(_, _, values)| !matches!(values, Values::F64(_)));
        let header = self.header();
        atomic_file::replace(path, |file| {
            file.write_all(&(header.len() as u64).to_le_bytes())?;
            file.write_all(header.as_bytes())?;
            self.tensors.iter().try_for_each(|(_, _, values)| values.write(file))
        })
    }

    fn header(&self) -> String {
        let mut header = Map::new();
        header.insert("__metadata__".to_owned(), json!(self.metadata));
        let mut start = 0;
        for (name, shape, values) in &self.tensors {
            let end = start + values.len_bytes();
            let entry =
                json!({"dtype": values.dtype(), "shape": shape, "data_offsets": [start, end]});
            header.insert(name.clone(), entry);
            start = end;
        }
        let mut text = Value::Object(header).to_string();
        // Padded so that the tensors start at a multiple of 8 bytes.
        text.extend(core::iter::repeat_n(' ', text.len().next_multiple_of(8) - text.len()));
        text
    }
}

/// A parsed file, with every access checked.
pub(crate) struct TensorReader<'a> {
    file: &'a Path,
    /// What the user can do about a file that does not fit.
    remedy: &'static str,
    metadata: HashMap<String, String>,
    tensors: SafeTensors<'a>,
}

impl<'a> TensorReader<'a> {
    pub fn parse(bytes: &'a [u8], file: &'a Path, remedy: &'static str) -> Result<Self> {
        let refuse = |error: safetensors::SafeTensorError| {
            let found = format!("{} bytes ({error})", bytes.len());
            Error::bad_input(file, "the file", found, "a whole safetensors file", remedy)
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(refuse)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(refuse)?;
        Ok(Self { file, remedy, metadata: header.metadata().clone().unwrap_or_default(), tensors })
    }

    pub fn metadata(&self, key: &str) -> Result<&str> {
        let missing = || self.refusal(format!("metadata `{key}`"), "missing", "a text");
        self.find_metadata(key).ok_or_else(missing)
    }

    /// Metadata that not every file has.
    pub fn find_metadata(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    pub fn json<T: DeserializeOwned>(&self, key: &str) -> Result<T> {
        serde_json::from_str(self.metadata(key)?).map_err(|error| {
            self.refusal(format!("metadata `{key}`"), error, "JSON of this program")
        })
    }

    pub fn frequencies(&self, name: &str, count: usize) -> Result<Vec<f64>> {
        Ok(words(self.bytes(name, Dtype::F64, &[count])?).map(f64::from_le_bytes).collect())
    }

    pub fn counts(&self, name: &str, count: usize) -> Result<Vec<u32>> {
        Ok(words(self.bytes(name, Dtype::U32, &[count])?).map(u32::from_le_bytes).collect())
    }

    /// `widths`: inputs of layer 1, then the outputs of every layer.
    pub fn layers(&self, prefix: &str, widths: &[usize]) -> Result<Vec<DenseLayer>> {
        let read_layer = |(index, pair): (usize, &[usize])| {
            Ok(DenseLayer {
                input_count: pair[0],
                output_count: pair[1],
                weights: self.floats(&format!("{prefix}.{index}.weight"), &[pair[1], pair[0]])?,
                bias: self.floats(&format!("{prefix}.{index}.bias"), &[pair[1]])?,
            })
        };
        widths.windows(2).enumerate().map(read_layer).collect()
    }

    /// What [`TensorWriter::trained_layers`] wrote.
    pub fn trained_layers(
        &self,
        prefix: &str,
        widths: &[usize],
        modulation: &[usize],
    ) -> Result<Vec<DenseLayer>> {
        let mut layers = self.layers(&format!("{prefix}.decoder"), widths)?;
        layers.extend(self.layers(&format!("{prefix}.modulation"), modulation)?);
        Ok(layers)
    }

    pub fn codes(&self, prefix: &str, shape: [usize; 2]) -> Result<CodeTable> {
        Ok(CodeTable {
            dimension_count: shape[1],
            mean: self.floats(&format!("{prefix}.mean"), &shape)?,
            log_variance: self.floats(&format!("{prefix}.log_variance"), &shape)?,
        })
    }

    pub fn code_moments(&self, name: &str, shape: [usize; 2]) -> Result<CodeMoments> {
        Ok(CodeMoments {
            first: self.codes(&format!("adam.first.{name}"), shape)?,
            second: self.codes(&format!("adam.second.{name}"), shape)?,
            step_counts: self.counts(&format!("adam.step_count.{name}"), shape[0])?,
        })
    }

    /// Rows and columns of a matrix whose size the file decides; `None` when there is no such tensor.
    pub fn find_matrix_shape(&self, name: &str) -> Option<[usize; 2]> {
        self.tensors.tensor(name).ok()?.shape().try_into().ok()
    }

    pub fn floats(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        Ok(words(self.bytes(name, Dtype::F32, shape)?).map(f32::from_le_bytes).collect())
    }

    fn bytes(&self, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&[u8]> {
        let field = || format!("tensor `{name}`");
        let expected = || format!("{dtype:?} of shape {shape:?}");
        let Ok(tensor) = self.tensors.tensor(name) else {
            return Err(self.refusal(field(), "missing", expected()));
        };
        if tensor.dtype() != dtype || tensor.shape() != shape {
            let found = format!("{:?} of shape {:?}", tensor.dtype(), tensor.shape());
            return Err(self.refusal(field(), found, expected()));
        }
        Ok(tensor.data())
    }

    /// This file's [`Error::BadInput`].
    pub fn refusal(
        &self,
        field: impl ToString,
        value: impl ToString,
        expected: impl ToString,
    ) -> Error {
        Error::bad_input(self.file, field, value, expected, self.remedy)
    }
}

/// Cuts bytes into little-endian words.
fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.as_chunks().0.iter().copied()
}
