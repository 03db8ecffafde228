#![no_std]
#![no_main]
//! Performs what the host performed, and prints each command.
//!
//! In:  blob, stint and cues, workspace width and channels, put into the program by `build.rs`.
//! Out: a line `pose` for each tick, with the numbers of its command; last a line `ram`. Each tick is a region for the
//!      instruction counter, where one listens.
//!
//! Why here: the device's half of `firmware-sim perform`; `firmware_sim::performance` compares the lines.

use cortex_m_rt::entry;
use firmware::cue::{Cue, Stint, numbers, perform};
use firmware::{or_refuse, print_numbers, region, stack};
use karakuri::limits::SERVOS_MAX;
use karakuri::{Model, Workspace};

/// Bytes at an address that every tensor's alignment divides.
#[repr(C, align(16))]
struct Aligned<Bytes: ?Sized>(Bytes);

include!(concat!(env!("OUT_DIR"), "/inputs.rs"));
include!(concat!(env!("OUT_DIR"), "/width.rs"));
include!(concat!(env!("OUT_DIR"), "/channels.rs"));

#[entry]
fn main() -> ! {
    perform_all();
    let ram = [stack::static_bytes(), stack::stack_bytes_max()];
    or_refuse("console", print_numbers("ram", &ram.map(|bytes| bytes as i32)));
    semihosting::process::exit(0)
}

fn perform_all() {
    let model = or_refuse("blob", Model::from_bytes(&BLOB.0));
    let mut workspace = Workspace::<WORKSPACE_WIDTH>::new();
    let (stint, cues) = or_refuse("performance", CASES.split_first_chunk().ok_or("too short"));
    let (cues, _) = cues.as_chunks::<{ Cue::BYTES }>();
    let cues = cues.iter().map(Cue::from_bytes);
    let stint = Stint::from_bytes(stint);
    let played =
        perform::<CHANNELS, _>(&model, &mut workspace, stint, cues, |_, elapsed_us, player| {
            let mut line = [0; SERVOS_MAX + 1];
            let mut count = 0;
            region::begin();
            let command = player.tick(elapsed_us);
            region::end_unnamed();
            for (place, number) in line.iter_mut().zip(numbers(command)) {
                *place = number;
                count += 1;
            }
            or_refuse("console", print_numbers("pose", &line[..count]));
        });
    or_refuse("performance", played);
}
