//! The command line of the host side: one verb a station.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use host_trainer::commands::{
    bake, bench, calibrate, character, check, classify, demo, evaluate, generate, inspect,
    inspect_clips, perform, plan, quantize, reconstruct, reproduce, samplers, train, tune,
};
use host_trainer::error::Result;

/// Learns motion from clips and puts it into a blob for a microcontroller.
#[derive(Debug, Parser)]
#[command(version, about, arg_required_else_help = true)]
#[command(
    after_help = "Start with:\n  host-trainer demo\n\nExit codes: 0 done, 1 `check` found something, \
    2 wrong flags, 3 bad input, \
    4 a file could not be read or written, 5 bad blob, 130 interrupted."
)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run the whole path on the built-in character
    Demo(demo::DemoArgs),
    /// Write the built-in character's clips
    Character(character::CharacterArgs),
    /// Explain clips or a blob
    Inspect(inspect_clips::InspectClipsArgs),
    /// Train a decoder and codes
    Train(train::TrainArgs),
    /// Measure how well a run and its blobs give the training clips back
    Reconstruct(reconstruct::ReconstructArgs),
    /// Make a run lose less to a number format
    Tune(tune::TuneArgs),
    /// Make a blob of a run
    Quantize(quantize::QuantizeArgs),
    /// Put the calibration of a robot's servos into a blob
    Calibrate(calibrate::CalibrateArgs),
    /// Say which clips a robot's servos cannot do
    Check(check::CheckArgs),
    /// Make new motions
    Generate(generate::GenerateArgs),
    /// Make new motions as files that other software and firmware play
    Bake(bake::BakeArgs),
    /// Tell a body at a serial line what to do
    Perform(perform::PerformArgs),
    /// Say whether a model fits a board, how fast it is there, and when keyframes are smaller
    Plan(plan::PlanArgs),
    /// Train the classifier that motions are evaluated by
    Classify(classify::ClassifyArgs),
    /// Measure how real generated motions are
    Evaluate(evaluate::EvaluateArgs),
    /// Compare samplers that fit flash
    Samplers(samplers::SamplersArgs),
    /// Do the papers' experiments and write one report
    Reproduce(reproduce::ReproduceArgs),
    /// Measure the speed of training
    Bench(bench::BenchArgs),
}

fn main() -> ExitCode {
    match run(&Cli::parse().verb) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(verb: &Verb) -> Result<()> {
    match verb {
        Verb::Demo(args) => demo::run(args),
        Verb::Character(args) => character::run(args),
        Verb::Inspect(args) => inspect::run(args),
        Verb::Train(args) => train::run(args),
        Verb::Reconstruct(args) => reconstruct::run(args),
        Verb::Tune(args) => tune::run(args),
        Verb::Quantize(args) => quantize::run(args),
        Verb::Calibrate(args) => calibrate::run(args),
        Verb::Check(args) => check::run(args),
        Verb::Generate(args) => generate::run(args),
        Verb::Bake(args) => bake::run(args),
        Verb::Perform(args) => perform::run(args),
        Verb::Plan(args) => plan::run(args),
        Verb::Classify(args) => classify::run(args),
        Verb::Evaluate(args) => evaluate::run(args),
        Verb::Samplers(args) => samplers::run(args),
        Verb::Reproduce(args) => reproduce::run(args),
        Verb::Bench(args) => bench::run(args),
    }
}
