//! `firmware-sim bench`: what does a motion cost on a chip?

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use indicatif::ProgressBar;
use karakuri::NumberFormat;
use karakuri::manifest::Packing;

use super::{print, print_json, progress_bar, read_blob};
use crate::benchmark::{Bench, Row, Subject};
use crate::error::Result;
use crate::network::Network;
use crate::synthetic::synthetic_blob;
use crate::target::Target;

mod tables;

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  firmware-sim bench --target cortex-m4 --format w8a16\n\n\
    Without MODEL and --network: the paper's network, with weights from a generator. Counts are\n\
    instructions as QEMU executes them, the same on every machine; it counts no cycles.")]
pub struct BenchArgs {
    /// Blobs of `host-trainer quantize` to count
    #[arg(value_name = "MODEL")]
    models: Vec<PathBuf>,
    /// Processors to build for and to emulate, each with its own flag; all unless given
    #[arg(long = "target", value_enum, value_name = "TARGET")]
    targets: Vec<Target>,
    /// Number formats of the networks, each with its own flag; all unless given
    #[arg(long = "format", value_name = "FORMAT", value_parser = format_parser())]
    formats: Vec<NumberFormat>,
    /// Networks to count, each with its own flag
    #[arg(long = "network", value_enum, value_name = "NETWORK")]
    networks: Vec<Network>,
    /// Print the rows as JSON
    #[arg(long)]
    json: bool,
}

fn format_parser() -> impl TypedValueParser<Value = NumberFormat> {
    let names = PossibleValuesParser::new(NumberFormat::ALL.map(NumberFormat::name));
    names.try_map(|name| {
        let known = NumberFormat::ALL.into_iter().find(|format| format.name() == name);
        known.ok_or("unknown number format")
    })
}

/// Counts everything that was asked for and prints it.
///
/// # Errors
/// See [`Bench`].
pub fn run(args: &BenchArgs) -> Result<()> {
    let targets = if args.targets.is_empty() { &Target::ALL } else { args.targets.as_slice() };
    let progress = progress_bar();
    let rows = count(args, targets, &progress);
    progress.finish_and_clear();
    let rows = rows?;
    if args.json { print_json(&rows) } else { print(tables::report(&rows)) }
}

fn count(args: &BenchArgs, targets: &[Target], progress: &ProgressBar) -> Result<Vec<Row>> {
    let files = args.models.iter().map(|path| file(path)).collect::<Result<Vec<_>>>()?;
    let bench = Bench::new()?;
    let mut rows = Vec::new();
    for &target in targets {
        let subjects = [files.clone(), networks(args, target)?].concat();
        progress.set_length((subjects.len() * targets.len()) as u64);
        rows.extend(bench.rows(&subjects, target, progress)?);
    }
    Ok(rows)
}

fn file(path: &Path) -> Result<Subject> {
    Ok(Subject { network: path.display().to_string(), blob: read_blob(path)? })
}

/// The networks in every format, packed as the target's kernels like it best.
fn networks(args: &BenchArgs, target: Target) -> Result<Vec<Subject>> {
    let default = if args.models.is_empty() { &[Network::Paper][..] } else { &[] };
    let networks = if args.networks.is_empty() { default } else { &args.networks };
    let formats =
        if args.formats.is_empty() { &NumberFormat::ALL } else { args.formats.as_slice() };
    let packing = if target == Target::CortexM55 { Packing::Rows } else { Packing::Tiles };
    let pairs = networks.iter().flat_map(|&network| formats.iter().map(move |&f| (network, f)));
    pairs
        .map(|(network, format)| {
            let blob = synthetic_blob(network, format, packing)?;
            Ok(Subject { network: network.name().to_owned(), blob })
        })
        .collect()
}
