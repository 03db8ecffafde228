//! Proves that the chip does what the float model did.
//!
//! Three questions, three verbs: does a chip compute the very bits that the host computes (`run`, in QEMU), how far are
//! those from the float model that was trained (`compare`), and what will the servos be told (`trace`)? The modules
//! stand in the order of their journeys.

pub mod error;

// run: model → cases → firmware → QEMU → transcript → parity
pub mod case;
pub mod choose_cases;
pub mod host;
pub mod target;
pub mod toolchain;
pub mod firmware;
pub mod qemu;
pub mod transcript;
pub mod parity;

// bench: network → blob → firmware and plugin → QEMU → counts, by region and by source → row
pub mod network;
pub mod synthetic;
pub mod plugin;
pub mod region_counts;
pub mod executable;
pub mod benchmark;

// compare: checkpoint and blob that belong together → reference → pairs of poses → error table
pub mod checkpoint;
pub mod belonging;
pub mod reference;
pub mod rotation;
pub mod error_table;
pub mod compare;

// trace: model → poses in virtual time → servo commands
pub mod trace;
pub mod serve;
pub mod shelf;
#[cfg(unix)]
pub mod pseudo_terminal;

// perform: model and script → cues → performance on host and chip → summary, picture
pub mod cue;
pub mod script;
pub mod show;
pub mod virtual_servo;
pub mod performance;

pub mod commands;

#[cfg(test)]
mod fixture;

pub use compare::{Comparison, compare};
pub use error::{Error, Result};
pub use parity::{Parity, run_parity};
pub use target::Target;
pub use trace::{Trace, trace};
