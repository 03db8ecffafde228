//! `host-trainer demo`: the whole path on the built-in character, and one closing table.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use karakuri::NumberFormat;

use serde_json::Value;

use crate::atomic_file::{self, Overwrite};
use crate::character;
use crate::checkpoint::Checkpoint;
use crate::commands::character::{check_out, write_folder};
use crate::commands::quantize::quantize_checkpoint;
use crate::config::TrainConfig;
use crate::dataset::{self, Dataset, DatasetOptions};
use crate::error::{Error, Result};
use crate::export::{self, ExportFormat};
use crate::generate::{Request, generate_blob};
use crate::inspect::blob::{BlobReport, load};
use crate::mixture;
use crate::picture;
use crate::quantize::QuantizeOptions;
use crate::reconstruct::{Source, reconstruct};
use crate::stdout::print;
use crate::table::{Table, thousands};
use crate::train::{Progress, Start, TrainOptions, train};

/// Arguments of `demo`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  host-trainer demo --out demo")]
pub struct DemoArgs {
    /// Folder for everything that the demo makes.
    #[arg(long, value_name = "DIR", default_value = "demo")]
    pub out: PathBuf,
    /// Preset to train.
    #[arg(long, default_value = "small")]
    pub preset: String,
    /// Training steps.
    #[arg(long, default_value_t = 6_000)]
    pub steps: u64,
    /// Seed of clips, training and motions.
    #[arg(long, default_value_t = 7)]
    pub seed: u64,
    /// Clips of each action.
    #[arg(long, default_value_t = character::DEFAULT_CLIPS_PER_ACTION,
          value_parser = clap::builder::RangedU64ValueParser::<usize>::new()
              .range(1..=character::CLIPS_PER_ACTION_MAX as u64))]
    pub clips_per_action: usize,
    /// Remove what an earlier demo left in the folder.
    #[arg(long)]
    pub force: bool,
}

/// One quantised model of the demo.
struct Product {
    path: PathBuf,
    report: BlobReport,
    error: String,
}

/// Generates clips, trains, quantises to every format, generates motions, verifies, and prints the table on stdout.
pub fn run(args: &DemoArgs) -> Result<()> {
    let mut config = TrainConfig::preset(&args.preset)?;
    config.seed = args.seed;
    config.budget.steps = args.steps;
    config.check(Path::new("the command line"))?;
    prepare_folder(&args.out, args.force)?;
    eprintln!("1/6  clips of the built-in character");
    let clip_set = character::clip_set(args.seed, args.clips_per_action);
    let clips = args.out.join("clips");
    write_folder(&clips, &clip_set, args.seed)?;
    let dataset =
        dataset::build(&clip_set, &DatasetOptions { standardization: config.standardization })?;

    eprintln!("2/6  training preset {}", args.preset);
    let run = args.out.join("run");
    let started = Instant::now();
    let checkpoint = train_demo(&dataset, &config, &run)?;
    let training_s = started.elapsed().as_secs_f64();

    eprintln!("3/6  mixtures over the codes");
    let mixtures = mixture::file::of_checkpoint(&run, &checkpoint)?;

    eprintln!("4/6  quantising");
    let calibration = character::calibration();
    let text = character::CALIBRATION.as_bytes();
    atomic_file::write(&args.out.join("calibration.toml"), text, Overwrite::Replace)?;
    let mut products = Vec::new();
    for format in NumberFormat::ALL {
        let name = character::NAME.to_lowercase();
        let path = args.out.join(format!("{name}-{}-{}.kara", args.preset, format.name()));
        let quantized = quantize_checkpoint(
            character::NAME,
            &checkpoint,
            &mixtures,
            &QuantizeOptions::new(format),
        )?;
        let blob = calibration.put_into(&path, &quantized.blob)?;
        atomic_file::write(&path, &blob, Overwrite::Replace)?;
        let model = load(&path, &blob)?;
        let error = scalar_error(&checkpoint, Source::Blob(&model), &dataset);
        products.push(Product { report: BlobReport::new(&path, &blob)?, path, error });
    }

    eprintln!("5/6  new motions, decoded in the device's arithmetic");
    let motions = args.out.join("motions");
    let motion_count = write_motions(&products[0].path, &motions, args.seed)?;

    eprintln!("6/6  the same arithmetic on a simulated Cortex-M4");
    let verdicts: Vec<String> =
        products.iter().map(|product| qemu_verdict(&product.path)).collect();

    let summary = summary(args, &dataset, training_s, &checkpoint, motion_count);
    let products_table = products_table(&products, &verdicts);
    print(format_args!("{summary}\n{products_table}\n{}\n", parts_table(&products)))
}

fn prepare_folder(out: &Path, force: bool) -> Result<()> {
    if !out.exists() {
        return Ok(());
    }
    if !force {
        return Err(Error::bad_input(
            out,
            "--out",
            "an existing folder",
            "a new folder",
            "choose another name, or add --force to remove what is in it",
        ));
    }
    // Only what a demo makes, and only beside clips of the character: a mistyped --out must not cost anything else.
    let made: Vec<PathBuf> = ["clips", "run", "motions"]
        .map(|name| out.join(name))
        .into_iter()
        .filter(|folder| folder.exists())
        .collect();
    match made.first() {
        Some(first) if first.ends_with("clips") => check_out(first, true)?,
        Some(first) => {
            let remedy = "choose another --out; --force replaces only what a demo wrote";
            return Err(Error::bad_input(
                first,
                "--out",
                "without a demo's clips",
                "a demo's folder",
                remedy,
            ));
        }
        None => (),
    }
    made.iter()
        .try_for_each(|folder| std::fs::remove_dir_all(folder).map_err(Error::io("remove", folder)))
}

fn train_demo(dataset: &Dataset, config: &TrainConfig, run: &Path) -> Result<Checkpoint> {
    let options = TrainOptions {
        start: Start::New,
        thread_count: None,
        stop: &AtomicBool::new(false),
        resume_command: "host-trainer demo --force",
        progress: Progress::Bar,
    };
    train(dataset, config, run, &options)
}

/// RMS over all servo channels.
fn scalar_error(checkpoint: &Checkpoint, source: Source<'_>, dataset: &Dataset) -> String {
    let reconstruction = reconstruct(checkpoint, source, dataset, &[], 1);
    let errors = reconstruction.kinds.iter().map(|kind| format!("{:.3} {}", kind.rms, kind.unit));
    errors.collect::<Vec<_>>().join(", ")
}

/// Three motions of every action, and a contact sheet of each.
fn write_motions(blob_path: &Path, out: &Path, seed: u64) -> Result<usize> {
    let blob = std::fs::read(blob_path).map_err(Error::io("read", blob_path))?;
    let model = load(blob_path, &blob)?;
    std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
    let rate_hz = f64::from(model.rate_millihz()) / 1000.0;
    let mut count = 0;
    for (index, action) in (0..).zip(model.actions()) {
        let frames = model.trained_frames(karakuri::ActionId(index));
        let seconds = f64::from((frames.start() + frames.end()) / 2) / rate_hz;
        let requests = (seed..seed + 3).map(|seed| Request {
            action: action.into(),
            seconds,
            seed,
            clamp: false,
            rate_hz: None,
        });
        let motions = requests
            .map(|request| generate_blob(blob_path, &model, &request))
            .collect::<Result<Vec<_>>>()?;
        for motion in &motions {
            let path = out.join(format!("{action}_seed{}.csv", motion.seed));
            export::write(motion, ExportFormat::Csv, &path, Overwrite::Refuse)?;
            count += 1;
        }
        let title = format!("{action}, {seconds:.1} s, three seeds");
        picture::write(&motions, &title, &out.join(format!("{action}.svg")), Overwrite::Refuse)?;
    }
    Ok(count)
}

/// Runs the simulator's parity check as a program of its own: only blob bytes pass between the two crates.
fn qemu_verdict(blob: &Path) -> String {
    let Some(cargo) = std::env::var_os("CARGO") else {
        return "not run: start the demo with cargo".into();
    };
    let output = Command::new(cargo)
        .args(["run", "--quiet", "--release", "-p", "firmware-sim", "--", "run"])
        .arg(blob)
        .args(["--target", "cortex-m4", "--json"])
        .stdin(Stdio::null())
        .output();
    match output {
        Ok(output) => verdict_of(&output),
        Err(reason) => format!("not run: {reason}"),
    }
}

/// What the simulator's JSON says; its own last words where there is none.
fn verdict_of(output: &Output) -> String {
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let number = |pointer: &str| report.pointer(pointer).and_then(Value::as_u64);
    match (number("/pose_count"), number("/differences/bits_differing")) {
        (Some(poses), Some(bits)) => format!("{} poses, {bits} bits differ", thousands(poses)),
        _ => {
            let words = String::from_utf8_lossy(&output.stderr);
            format!(
                "not verified: {}",
                words.lines().last().unwrap_or("the simulator says nothing")
            )
        }
    }
}

fn summary(
    args: &DemoArgs,
    dataset: &Dataset,
    training_s: f64,
    checkpoint: &Checkpoint,
    motion_count: usize,
) -> String {
    let description = &dataset.description;
    let frames: usize = description.clips.iter().map(|clip| clip.frame_count).sum();
    let mut table = Table::new(["", ""]);
    let clip_count = description.clips.len();
    let action_count = description.actions.len();
    table.push([
        "clips".into(),
        format!(
            "{clip_count} of {action_count} actions, {:.0} s",
            frames as f64 / description.rate_hz
        ),
    ]);
    table.push([
        "training".into(),
        format!("{training_s:.0} s, {} steps, preset {}", args.steps, args.preset),
    ]);
    table.push(["float model's error".into(), scalar_error(checkpoint, Source::Float, dataset)]);
    table.push([
        "new motions".into(),
        format!("{motion_count} in {}", args.out.join("motions").display()),
    ]);
    table.push(["everything".into(), format!("in {}", args.out.display())]);
    table.to_string()
}

fn products_table(products: &[Product], verdicts: &[String]) -> Table {
    let mut table = Table::new([
        "blob",
        "bytes",
        "RAM bytes",
        "multiply-accumulates a pose",
        "RMS error",
        "on a Cortex-M4",
    ]);
    for (product, verdict) in products.iter().zip(verdicts) {
        table.push([
            product.path.display().to_string(),
            thousands(product.report.bytes as u64),
            thousands(product.report.ram_bytes as u64),
            thousands(product.report.multiply_accumulates_per_pose),
            product.error.clone(),
            verdict.clone(),
        ]);
    }
    table
}

fn parts_table(products: &[Product]) -> String {
    // By pattern, so that a new format does not compile before it has a column.
    let [a, b, c, d] = NumberFormat::ALL.map(NumberFormat::name);
    let mut table = Table::new(["bytes by part", a, b, c, d]);
    for part in &products[0].report.parts {
        let bytes = |format: NumberFormat| {
            let of_format = products.iter().filter(|made| made.report.format == format.name());
            let mut parts = of_format.flat_map(|made| &made.report.parts);
            let found = parts.find(|found| found.part == part.part);
            found.map_or_else(|| "–".into(), |found| thousands(found.bytes))
        };
        let [a, b, c, d] = NumberFormat::ALL.map(bytes);
        table.push([part.part.into(), a, b, c, d]);
    }
    table.to_string()
}
