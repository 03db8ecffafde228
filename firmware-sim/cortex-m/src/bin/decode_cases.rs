#![no_std]
#![no_main]
//! Decodes every case with the blob under test and prints each pose.
//!
//! In:  blob, cases and workspace width, put into the program by `build.rs`.
//! Out: a line `pose` for each pose, in the order of the cases; last a line `ram`: bytes of statics, bytes of stack.
//!
//! Why here: the device's half of the parity proof; `firmware_sim::parity` compares the lines with the host's poses.

use cortex_m_rt::entry;
use firmware::case::Case;
use firmware::{or_refuse, print_numbers, stack};
use karakuri::{Decoder, Model, Workspace};

/// Bytes at an address that every tensor's alignment divides.
#[repr(C, align(16))]
struct Aligned<Bytes: ?Sized>(Bytes);

include!(concat!(env!("OUT_DIR"), "/inputs.rs"));
include!(concat!(env!("OUT_DIR"), "/width.rs"));

#[entry]
fn main() -> ! {
    decode_cases();
    let ram = [stack::static_bytes(), stack::stack_bytes_max()];
    or_refuse("console", print_numbers("ram", &ram.map(|bytes| bytes as i32)));
    semihosting::process::exit(0)
}

fn decode_cases() {
    let model = or_refuse("blob", Model::from_bytes(&BLOB.0));
    let mut workspace = Workspace::<WORKSPACE_WIDTH>::new();
    let mut decoder = or_refuse("workspace", Decoder::new(&model, &mut workspace));
    let (cases, _) = CASES.as_chunks::<{ Case::BYTES }>();
    for case in cases.iter().map(Case::from_bytes) {
        let outcome = case.decode(&model, &mut decoder, |pose| {
            or_refuse("console", print_numbers("pose", pose.channels()));
        });
        or_refuse("case", outcome);
    }
}
