//! Command line of the simulator; every verb is a file in `commands/`.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
#[cfg(unix)]
use firmware_sim::commands::serve;
use firmware_sim::commands::{bench, compare, perform, run, trace};

/// Proves that the chip does what the float model did.
#[derive(Parser)]
#[command(version, about, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

const EXIT_CODES: &str = "Exit codes: 0 done and equal, 1 a difference beyond the format's promise or a limit broken, \
    2 wrong usage, 3 bad input, 4 input/output, 5 bad blob, 6 missing tool, 7 firmware failed";

#[derive(Subcommand)]
enum Verb {
    /// Run a blob on an emulated chip and compare its poses with the host's, bit by bit
    Run(run::RunArgs),
    /// Tabulate the error of a blob against the float model that it was made of
    Compare(compare::CompareArgs),
    /// Count what a motion costs on emulated chips: instructions, flash, RAM
    Bench(bench::BenchArgs),
    /// Let a character live for an hour without a body: limits, rest and repeats are counted
    Perform(perform::PerformArgs),
    /// Write what the servos of a robot would be told, tick by tick, without a robot
    Trace(trace::TraceArgs),
    /// Be a body at a line, for `host-trainer perform`
    #[cfg(unix)]
    Serve(serve::ServeArgs),
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().verb {
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Compare(arguments) => compare::run(&arguments).map(|()| true),
        Verb::Bench(arguments) => bench::run(&arguments).map(|()| true),
        Verb::Perform(arguments) => perform::run(&arguments),
        Verb::Trace(arguments) => trace::run(&arguments).map(|()| true),
        #[cfg(unix)]
        Verb::Serve(arguments) => serve::run(&arguments).map(|()| true),
    };
    match outcome {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
