//! `firmware-sim bench`: what does a motion cost on a chip?

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use karakuri::NumberFormat;

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
    let subjects = subjects(args)?;
    let targets = if args.targets.is_empty() { &Target::ALL } else { args.targets.as_slice() };
    let progress = progress_bar();
    progress.set_length((subjects.len() * targets.len()) as u64);
    let rows = count(&subjects, targets, &progress);
    progress.finish_and_clear();
    let rows = rows?;
    if args.json { print_json(&rows) } else { print(tables::report(&rows)) }
}

fn count(
    subjects: &[Subject],
    targets: &[Target],
    progress: &indicatif::ProgressBar,
) -> Result<Vec<Row>> {
    let bench = Bench::new()?;
    let rows = targets.iter().map(|&target| bench.rows(subjects, target, progress));
    Ok(rows.collect::<Result<Vec<_>>>()?.concat())
}

/// The files, then the networks in every format.
fn subjects(args: &BenchArgs) -> Result<Vec<Subject>> {
    let file = |path: &PathBuf| {
        let network = Path::display(path).to_string();
        Ok(Subject { network, blob: read_blob(path)? })
    };
    let mut subjects = args.models.iter().map(file).collect::<Result<Vec<_>>>()?;
    let default = if args.models.is_empty() { &[Network::Paper][..] } else { &[] };
    let networks = if args.networks.is_empty() { default } else { &args.networks };
    let formats =
        if args.formats.is_empty() { &NumberFormat::ALL } else { args.formats.as_slice() };
    for &network in networks {
        for &format in formats {
            let blob = synthetic_blob(network, format)?;
            subjects.push(Subject { network: network.name().to_owned(), blob });
        }
    }
    Ok(subjects)
}
