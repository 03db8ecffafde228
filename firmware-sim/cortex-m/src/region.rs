//! Marks a part of a run for the instruction counter.
//!
//! In:  work to be counted, and its name.
//! Out: a line `region <name>` for each region, in the order in which `instruction_count.c` writes their counts.
//!
//! Why here: the only file with the marking instructions. Names are printed between regions and cost nothing.

#![allow(unsafe_code)]

use core::arch::asm;
use core::fmt::Display;

use semihosting::println;

/// Counts the instructions of `work`.
#[inline(always)]
pub fn count<Output>(name: impl Display, work: impl FnOnce() -> Output) -> Output {
    begin();
    let output = work();
    end(name);
    output
}

/// Begins a region; all counts are zero from here.
#[inline(always)]
pub fn begin() {
    // SAFETY: moves a register to itself, which changes nothing. Neither `nomem` nor `pure`: memory is not touched,
    // but the compiler must keep the marker in its place among the accesses around it.
    unsafe { asm!("mov r10, r10", options(nostack, preserves_flags)) };
}

/// Ends the region that was begun last and gives it a name.
#[inline(always)]
pub fn end(name: impl Display) {
    end_unnamed();
    println!("region {name}");
}

/// Ends the region that was begun last, for a reader who knows what it is.
#[inline(always)]
pub fn end_unnamed() {
    // SAFETY: as in `begin`.
    unsafe { asm!("mov r11, r11", options(nostack, preserves_flags)) };
}
