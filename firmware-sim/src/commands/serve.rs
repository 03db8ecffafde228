//! `firmware-sim serve MODEL.kara --pty`: a body without a robot, at a line that programs can open.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use karakuri::Model;

use super::{print, read_blob};
use crate::error::{Error, Result};
use crate::host::widest_workspace;
use crate::pseudo_terminal::PseudoTerminal;
use crate::serve::{LineEnd, Served, player};
use crate::trace::{Options, TICK_HZ, US_PER_S_MAX, US_PER_S2_MAX, US_PER_UNIT};

/// What the user typed.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example, in two terminals:\n  firmware-sim serve creature.kara --pty\n  \
    host-trainer perform --serial /dev/pts/3 --model creature.kara --script day.txt")]
pub struct ServeArgs {
    /// Blob of `host-trainer quantize`
    model: PathBuf,
    /// Serve at a pseudo-terminal, whose path is printed
    #[arg(long, required = true)]
    pty: bool,
    /// Seed of what the body does on its own
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// End after so long
    #[arg(long, default_value_t = 60.0, value_parser = minutes)]
    minutes: f64,
}

fn minutes(text: &str) -> std::result::Result<f64, String> {
    let minutes = text.parse().ok().filter(|minutes| (0.0..=1e6).contains(minutes));
    minutes.ok_or_else(|| "expected a number of minutes, 0 to a million".into())
}

/// Prints the path of the line, then serves until the time is over, anew with every blob that the host sends.
///
/// # Errors
/// A blob that cannot be served, a system without pseudo-terminals.
pub fn run(args: &ServeArgs) -> Result<()> {
    let blob = read_blob(&args.model)?;
    let in_file = |error: Error| error.in_file(&args.model);
    let terminal = PseudoTerminal::open().map_err(Error::io("open", "a pseudo-terminal"))?;
    let options = Options {
        action: String::new(),
        seconds: 0.0,
        seed: args.seed,
        clamp: false,
        tick_hz: TICK_HZ,
        us_per_unit: US_PER_UNIT,
        us_per_s_max: US_PER_S_MAX,
        us_per_s2_max: US_PER_S2_MAX,
        stand_in: false,
    };
    let mut end = LineEnd::new(&terminal.line, &options);
    let tick = Duration::from_secs(1) / TICK_HZ;
    let until = Instant::now() + Duration::from_secs_f64(args.minutes * 60.0);
    let mut next = Some(blob);
    let mut is_announced = false;
    while let Some(blob) = next {
        let model = Model::from_bytes(&blob).map_err(|error| in_file(error.into()))?;
        let mut workspace = widest_workspace();
        let player = player(&model, &mut workspace, &options).map_err(in_file)?;
        if is_announced {
            eprintln!("another blob, {} bytes; servos released", blob.len());
        } else {
            print(format!("{}\n", terminal.path.display()))?;
            eprintln!("serving; stop with Ctrl-C");
            is_announced = true;
        }
        let served = Served::new(player, &mut end).serve(&terminal.heard, tick, until);
        next = served.map_err(Error::io("write to", &terminal.path))?;
    }
    Ok(())
}
