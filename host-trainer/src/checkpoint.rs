//! Station 4: everything that training made, in one file that is replaced atomically.
//!
//! `RUN/checkpoint.safetensors` holds the tensors `decoder.{i}.weight` (out, in), `decoder.{i}.bias` (out),
//! `sequence_code.mean`, `sequence_code.log_variance`, `action_code.mean`, `action_code.log_variance` (row, dimension)
//! and `frequencies_rad` (pair, f64), the optimiser's moments under `adam.*`, and in its metadata `config` (TOML),
//! `dataset` (JSON of `DatasetDescription`) and `state` (JSON).
