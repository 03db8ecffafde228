//! `host-trainer samplers`: what every sampler that could fit flash scores, and what it costs.

use serde::Serialize;

use crate::atomic_file::{self, Overwrite};
use crate::checkpoint::Checkpoint;
use crate::classifier::Classifier;
use crate::commands::evaluate::{EvaluateArgs, file_hash, read_data, read_order};
use crate::error::{Error, Result};
use crate::evaluate::evaluate;
use crate::evaluate::judge::Judge;
use crate::evaluate::report::{ClassifierDescription, Figures};
use crate::evaluate::source::FloatSource;
use crate::mixture;
use crate::picture::front::{Mark, draw};
use crate::sampler::family::{Family, samplers};
use crate::stdout::{print, print_json};
use crate::table::Table;
use crate::train::Progress;

/// Arguments of `samplers`.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  host-trainer samplers runs/small --data clips --classifier classifier.safetensors \
    --repetitions 5 --out fronts"
)]
pub struct SamplersArgs {
    /// What it is measured with; the source is the folder of a run.
    #[command(flatten)]
    pub evaluate: EvaluateArgs,
    /// Families to measure, with commas; mixtures of large codes take many minutes to fit.
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["intervals", "choice", "coding", "mixtures"])]
    pub families: Vec<Family>,
}

/// One sampler, measured.
#[derive(Clone, Debug, Serialize)]
pub struct SamplerRow {
    /// What it is.
    pub sampler: String,
    /// Of its tables.
    pub bytes: usize,
    /// No other is better in both bytes and FID.
    pub is_on_front: bool,
    /// What it scores over the float decoder.
    #[serde(flatten)]
    pub figures: Figures,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    run: String,
    config_hash: &'a str,
    seed: u64,
    rows: &'a [SamplerRow],
}

/// Prints the table; with `--out` also writes it, and the front.
///
/// # Errors
/// Those of `evaluate`, and a blob in the place of a run.
pub fn run(args: &SamplersArgs) -> Result<()> {
    let source = &args.evaluate.source;
    if !source.is_dir() {
        return Err(Error::bad_input(
            source,
            "the source",
            "a file",
            "the folder of a run: samplers are compared over its float decoder",
            "give the run that the blob was made of",
        ));
    }
    check_flags(args)?;
    let files =
        args.evaluate.out.as_ref().map(|out| [out.join("samplers.json"), out.join("samplers.svg")]);
    let overwrite = Overwrite::from_force(args.evaluate.force);
    files.iter().flatten().try_for_each(|file| atomic_file::check(file, overwrite))?;
    let checkpoint = Checkpoint::load(source)?;
    let mut rows = measure(args, &checkpoint)?;
    mark_front(&mut rows);
    let report = Report {
        run: source.display().to_string(),
        config_hash: &checkpoint.state.config_hash,
        seed: args.evaluate.seed,
        rows: &rows,
    };
    if let (Some([table, picture]), Some(out)) = (&files, &args.evaluate.out) {
        std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
        let json = serde_json::to_vec_pretty(&report);
        let json = json.unwrap_or_else(|error| unreachable!("plain structs: {error}"));
        atomic_file::write(table, &json, overwrite)?;
        let title = format!("Samplers of {}", report.run);
        atomic_file::write(picture, draw(&title, &marks(&rows)).as_bytes(), overwrite)?;
        eprintln!("wrote {} and {}", table.display(), picture.display());
    }
    if args.evaluate.json { print_json(&report) } else { print(table(&rows)) }
}

/// Flags of `evaluate` that choose what is measured have no place here.
fn check_flags(args: &SamplersArgs) -> Result<()> {
    let given = [
        ("--sampler", args.evaluate.sampler.sampler.is_some()),
        ("--replay", args.evaluate.replay),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((flag, _)) => {
            let source = &args.evaluate.source;
            let remedy = "leave it out, or use `evaluate`";
            Err(Error::bad_input(source, flag, "given", "--families", remedy))
        }
    }
}

fn measure(args: &SamplersArgs, checkpoint: &Checkpoint) -> Result<Vec<SamplerRow>> {
    let run = &args.evaluate.source;
    let data = read_data(&args.evaluate, Some((run.as_path(), checkpoint)))?;
    let classifier = Classifier::load(&args.evaluate.classifier)?;
    let description = ClassifierDescription {
        file: args.evaluate.classifier.display().to_string(),
        sha256: file_hash(&args.evaluate.classifier)?,
    };
    let order = args.evaluate.action_order_column.as_deref();
    let order = order
        .map(|column| read_order(&args.evaluate.data, &args.evaluate.import, column))
        .transpose()?;
    let judge = Judge::new(&classifier, description, &data, order.as_deref())?;
    let mixtures = mixture::file::of_checkpoint(run, checkpoint)?;
    let mut rows = Vec::new();
    for &family in &args.families {
        for sampler in samplers(family, checkpoint, &mixtures)? {
            let source = FloatSource::new(checkpoint, &*sampler, run.display().to_string(), "")?;
            let protocol = args.evaluate.protocol();
            let name = sampler.name();
            let found = evaluate(&source, &data, &judge, &protocol, Progress::Bar)?;
            let (bytes, fid) = (kib(sampler.bytes()), &found.generated.fid);
            eprintln!("{name}: {bytes:.1} KiB, FID {:.4} +- {:.4}", fid.mean, fid.ci95);
            rows.push(SamplerRow {
                sampler: name,
                bytes: sampler.bytes(),
                is_on_front: false,
                figures: found.generated,
            });
        }
    }
    Ok(rows)
}

fn mark_front(rows: &mut [SamplerRow]) {
    let all: Vec<(usize, f64)> = rows.iter().map(|row| (row.bytes, row.figures.fid.mean)).collect();
    for row in rows {
        let (bytes, fid) = (row.bytes, row.figures.fid.mean);
        let beats = |&(b, f): &(usize, f64)| b <= bytes && f <= fid && (b, f) != (bytes, fid);
        row.is_on_front = !all.iter().any(beats);
    }
}

fn kib(bytes: usize) -> f64 {
    bytes as f64 / 1024.0
}

fn marks(rows: &[SamplerRow]) -> Vec<Mark> {
    let mark = |row: &SamplerRow| Mark {
        name: row.sampler.clone(),
        kib: kib(row.bytes),
        fid: row.figures.fid.mean,
        is_on_front: row.is_on_front,
    };
    rows.iter().map(mark).collect()
}

fn table(rows: &[SamplerRow]) -> Table {
    let mut table = Table::new([
        "sampler (* on the front)",
        "KiB",
        "FID",
        "+-",
        "accuracy",
        "diversity",
        "multimodality",
        "MMS",
    ]);
    for row in rows {
        let figures = &row.figures;
        let star = if row.is_on_front { " *" } else { "" };
        table.push([
            format!("{}{star}", row.sampler),
            format!("{:.1}", kib(row.bytes)),
            format!("{:.4}", figures.fid.mean),
            format!("{:.4}", figures.fid.ci95),
            format!("{:.4}", figures.accuracy.mean),
            format!("{:.3}", figures.diversity.mean),
            format!("{:.3}", figures.multimodality.mean),
            format!("{:.3}", figures.mms.mean),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::estimate::Estimate;

    fn row(bytes: usize, fid: f64) -> SamplerRow {
        let none = Estimate::default();
        let figures = Figures {
            fid: Estimate { mean: fid, ci95: 0.0 },
            fid_held_out: None,
            accuracy: none,
            diversity: none,
            multimodality: none,
            mms: none,
            apd: none,
            apd_normalized: none,
            accuracy_by_action: Vec::new(),
            physical: None,
        };
        SamplerRow { sampler: String::new(), bytes, is_on_front: false, figures }
    }

    #[test]
    fn front_holds_what_nothing_beats_in_bytes_and_fid() {
        let mut rows = [row(10, 0.3), row(20, 0.1), row(20, 0.2), row(30, 0.1), row(40, 0.05)];
        mark_front(&mut rows);
        assert_eq!(rows.map(|row| row.is_on_front), [true, true, false, false, true]);
    }
}
