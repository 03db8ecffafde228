//! How much memory the program has used so far.
//!
//! In:  the stack as start-up code painted it (`cortex-m-rt`'s `paint-stack`), and the linker's symbols.
//! Out: bytes of statics, and bytes of stack at its deepest.
//!
//! Why here: the only file that reads raw memory, so that its safety argument stands beside it.

#![allow(unsafe_code)]

use core::ptr;

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    /// First word above all statics: the stack may grow down to here.
    static _stack_end: u32;
    /// First word above the stack.
    static _stack_start: u32;
    /// First word of RAM.
    static _ram_start: u32;
}

/// Bytes of RAM that statics occupy.
pub fn static_bytes() -> usize {
    (&raw const _stack_end).addr() - (&raw const _ram_start).addr()
}

/// Bytes of stack used at the deepest moment since reset.
///
/// Exact unless the deepest words happen to hold the paint's own pattern.
pub fn stack_bytes_max() -> usize {
    let top = &raw const _stack_start;
    let mut word = &raw const _stack_end;
    // SAFETY: every address from `_stack_end` up to `_stack_start` is RAM that the linker script reserves for the
    // stack; both symbols are 4-byte aligned (asserted by link.x). The reads are volatile because the compiler knows
    // nothing of this memory, and nothing writes to it meanwhile: the words above the stack pointer stay as they are.
    while word < top && unsafe { ptr::read_volatile(word) } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    top.addr() - word.addr()
}
