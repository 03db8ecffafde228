#![no_std]
//! What every program here needs around `main`: a way to print poses and a way out.
//!
//! In:  poses and figures of the programs in `bin/`.
//! Out: lines on the semihosting console, read by `firmware_sim::transcript`; an exit code for QEMU.
//!
//! Why here: a fault or a panic must end the run with a non-zero exit code. The start-up code's own handlers
//! loop for ever, which a test sees only as silence. The panic handler is that of `semihosting`: a message, then
//! exit code 101.

use cortex_m_rt::{ExceptionFrame, exception};
use semihosting::{io, io::Write, println, process};

/// Defined once for host and device.
#[path = "../../src/case.rs"]
pub mod case;
#[path = "../../src/cue.rs"]
pub mod cue;
pub mod blob_partition;
pub mod region;
pub mod stack;

/// Exit code of a program that refuses its blob or its cases.
pub const EXIT_BAD_INPUT: i32 = 2;
/// Exit code of a program that ran into a hard fault.
pub const EXIT_HARD_FAULT: i32 = 102;

/// Numbers per write; each write stops the emulator once, so larger is faster and costs stack.
const NUMBERS_PER_WRITE: usize = 32;
const DIGITS: usize = 8;

/// Prints `<word> <number><number>…`, eight hexadecimal digits a number, two's complement.
#[inline(never)]
pub fn print_numbers(word: &str, numbers: &[i32]) -> io::Result<()> {
    let mut stdout = io::stdout()?;
    stdout.write_all(word.as_bytes())?;
    stdout.write_all(b" ")?;
    for chunk in numbers.chunks(NUMBERS_PER_WRITE) {
        let mut text = [0; NUMBERS_PER_WRITE * DIGITS];
        for (number, digits) in chunk.iter().zip(text.chunks_exact_mut(DIGITS)) {
            write_hex(*number, digits);
        }
        stdout.write_all(&text[..chunk.len() * DIGITS])?;
    }
    stdout.write_all(b"\n")
}

fn write_hex(number: i32, digits: &mut [u8]) {
    let mut rest = number as u32;
    for digit in digits.iter_mut().rev() {
        *digit = b"0123456789abcdef"[(rest & 0xf) as usize];
        rest >>= 4;
    }
}

/// The value, or the end of the program with the reason why there is none.
pub fn or_refuse<Value, Reason: core::fmt::Debug>(
    what: &str,
    outcome: Result<Value, Reason>,
) -> Value {
    outcome.unwrap_or_else(|reason| {
        println!("error {what}: {reason:?}");
        process::exit(EXIT_BAD_INPUT)
    })
}

/// Reports a hard fault instead of hanging in it.
// Safety: the attribute asks for `unsafe fn` because nothing may be assumed of the interrupted program; this handler
// touches none of its data and never returns to it.
#[allow(unsafe_code)]
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    println!("error hard fault at {:#010x}", frame.pc());
    process::exit(EXIT_HARD_FAULT)
}
