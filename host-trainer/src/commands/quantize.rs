//! `host-trainer quantize`: checkpoint → `.kara`.

use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};
use karakuri::NumberFormat;
use karakuri::manifest::{Packing, Provenance};
use karakuri::servo_records::servos_bytes;

use crate::atomic_file::{self, Overwrite};
use crate::calibration::Calibration;
use crate::checkpoint::{Checkpoint, Tuning};
use crate::commands::sampler_args::{ClipArgs, SamplerArg};
use crate::error::Result;
use crate::inspect::blob::BlobReport;
use crate::mixture;
use crate::mixture::set::MixtureSet;
use crate::quantize::flash_budget::{FlashBudget, quantize_within};
use crate::quantize::layer::InputScale;
use crate::quantize::{QuantizeInput, QuantizeOptions, Quantized, quantize};
use crate::stdout::{print, print_json};

/// Arguments of `quantize`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer quantize runs/creature --format w8a16 --out creature.kara"
)]
pub struct QuantizeArgs {
    /// Folder of the trained run.
    pub run: PathBuf,
    /// Number format of weights and activations.
    #[arg(long, value_enum, default_value_t = FormatArg::W8a16)]
    pub format: FormatArg,
    /// The blob to write.
    #[arg(long, value_name = "FILE.kara")]
    pub out: PathBuf,
    /// How the device draws codes.
    #[arg(long, value_enum, default_value_t = SamplerArg::NearestClips)]
    pub sampler: SamplerArg,
    /// How clips become motions.
    #[command(flatten)]
    pub clips: ClipArgs,
    /// Order of 8-bit weights: tiles for every chip, rows for vector units (Cortex-M55) and hosts.
    #[arg(long, value_enum, default_value_t = PackingArg::Tiles)]
    pub packing: PackingArg,
    /// Store what time adds to layer 1 for this many whole frames: a fifth of the work per pose less at the paper's
    /// size, for 2 bytes a frame and output of layer 1.
    #[arg(long, value_name = "FRAMES", default_value_t = 0)]
    pub time_table: u16,
    /// Fit the blob into so much flash (bytes, or 256K, 1M): picks 4- or 8-bit weights for each layer at the least
    /// error and prints the trade-off curve. Activations have 8 bits.
    #[arg(long, value_name = "SIZE", value_parser = parse_size, conflicts_with = "format")]
    pub flash: Option<usize>,
    /// Calibration of a robot's servos, to become part of the blob.
    #[arg(long, value_name = "FILE.toml")]
    pub calibration: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long)]
    pub force: bool,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Number formats by their command-line names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FormatArg {
    /// i8 weights, i16 activations: the best quality of the integer formats.
    W8a16,
    /// i8 weights, i8 activations: a fifth fewer instructions on a Cortex-M4.
    W8a8,
    /// 4-bit weights with group scales, i8 activations: half the flash.
    W4a8,
    /// binary16 weights, f32 activations: for parts with an FPU.
    F16,
}

impl From<FormatArg> for NumberFormat {
    fn from(format: FormatArg) -> Self {
        match format {
            FormatArg::W8a16 => Self::W8A16,
            FormatArg::W8a8 => Self::W8A8,
            FormatArg::W4a8 => Self::W4A8,
            FormatArg::F16 => Self::F16,
        }
    }
}

/// Packings by their command-line names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PackingArg {
    /// Four rows by four columns: what the assembly kernels read; everyone else can.
    Tiles,
    /// Row after row: what vector units read fastest; the assembly kernels refuse it.
    Rows,
}

impl From<PackingArg> for Packing {
    fn from(packing: PackingArg) -> Self {
        match packing {
            PackingArg::Tiles => Self::Tiles,
            PackingArg::Rows => Self::Rows,
        }
    }
}

impl QuantizeArgs {
    fn options(&self) -> QuantizeOptions {
        QuantizeOptions {
            packing: self.packing.into(),
            sampler: self.sampler.choice(&self.clips),
            time_table_frames: self.time_table,
            ..QuantizeOptions::new(self.format.into())
        }
    }
}

/// Quantises a run and prints the blob's report on stdout.
pub fn run(args: &QuantizeArgs) -> Result<()> {
    let overwrite = Overwrite::from_force(args.force);
    atomic_file::check(&args.out, overwrite)?;
    let checkpoint = Checkpoint::load(&args.run)?;
    let calibration = args.calibration.as_deref().map(Calibration::read).transpose()?;
    // Refused before the work that it would cost.
    let servo_count = match &calibration {
        Some(calibration) => calibration.servos(&checkpoint.dataset.layout)?.len(),
        None => 0,
    };
    let mixtures = mixture::file::of_checkpoint(&args.run, &checkpoint)?;
    let name = args.run.file_name().map_or_else(|| "model".into(), |name| name.to_string_lossy());
    let (quantized, flash_budget) = match args.flash {
        None => (quantize_checkpoint(&name, &checkpoint, &mixtures, &args.options())?, None),
        Some(bytes_max) => {
            let bytes_max = match servo_count {
                0 => bytes_max,
                count => bytes_max.saturating_sub(servos_bytes(count)),
            };
            if let Some(tuning) = &checkpoint.state.tuning {
                let format = &tuning.format;
                eprintln!(
                    "note: tuned for {format} as it is by default; --flash may pick other bits than tuning saw"
                );
            }
            let input = input_of(&name, &checkpoint, &mixtures, None);
            let progress = progress_bar();
            let within = quantize_within(&input, &args.options(), bytes_max, &progress)?;
            (within.0, Some(within.1))
        }
    };
    let blob = match &calibration {
        Some(calibration) => calibration.put_into(&args.out, &quantized.blob)?,
        None => quantized.blob,
    };
    atomic_file::write(&args.out, &blob, overwrite)?;
    let blob = BlobReport::new(&args.out, &blob)?;
    if args.json {
        print_json(&Report { blob, flash_budget })?;
    } else {
        print(&blob)?;
        print_accumulator_use(&quantized.accumulator_use)?;
        flash_budget.iter().try_for_each(print)?;
    }
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

/// On stderr; its length is set by what reports to it.
pub fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} layers priced {elapsed}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// What `--json` prints.
#[derive(serde::Serialize)]
struct Report {
    #[serde(flatten)]
    blob: BlobReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    flash_budget: Option<FlashBudget>,
}

fn print_accumulator_use(accumulator_use: &[f64]) -> Result<()> {
    if accumulator_use.is_empty() {
        return Ok(());
    }
    let percent = |share: &f64| format!("{:.0} %", 100.0 * share);
    let shares: Vec<String> = accumulator_use.iter().map(percent).collect();
    print(format_args!(
        "\naccumulators proven to stay below 2^31, worst row of each layer: {}\n",
        shares.join("  ")
    ))
}

/// `250000`, `256K` or `1M`; K and M count by 1024.
pub fn parse_size(text: &str) -> std::result::Result<usize, String> {
    let (digits, unit) = match text.as_bytes().last() {
        Some(b'k' | b'K') => (&text[..text.len() - 1], 1 << 10),
        Some(b'm' | b'M') => (&text[..text.len() - 1], 1 << 20),
        _ => (text, 1),
    };
    let number: Option<usize> = digits.parse().ok();
    let bytes = number.filter(|&number| number > 0).and_then(|number| number.checked_mul(unit));
    bytes.ok_or_else(|| "expected bytes as 250000, 256K or 1M".to_owned())
}

/// [`quantize`] for a whole checkpoint.
pub fn quantize_checkpoint(
    name: &str,
    checkpoint: &Checkpoint,
    mixtures: &MixtureSet,
    options: &QuantizeOptions,
) -> Result<Quantized> {
    let tuning = checkpoint.state.tuning.as_ref();
    let tuning = tuning.filter(|tuning| tuning.format == options.format.name());
    let tuned = tuning.map(|tuning| tuning.inputs(options.format));
    let weights = options.weights.clone().or_else(|| tuning.and_then(Tuning::weights));
    let options = QuantizeOptions { weights, ..options.clone() };
    quantize(&input_of(name, checkpoint, mixtures, tuned.as_deref()), &options)
}

/// The quantiser's view of a checkpoint; `tuned` is how tuning has settled that activations are stored.
pub fn input_of<'a>(
    name: &'a str,
    checkpoint: &'a Checkpoint,
    mixtures: &'a MixtureSet,
    tuned: Option<&'a [InputScale]>,
) -> QuantizeInput<'a> {
    QuantizeInput {
        name,
        model: &checkpoint.model,
        sequence_codes: &checkpoint.sequence_codes,
        action_codes: &checkpoint.action_codes,
        dataset: &checkpoint.dataset,
        mixtures,
        tuned,
        provenance: Provenance {
            config_hash: checkpoint.config.config_hash(),
            seed: checkpoint.config.seed,
        },
    }
}
