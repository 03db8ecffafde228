//! How much memory the program, or a part of it, has used.
//!
//! In:  the stack as start-up code painted it (`cortex-m-rt`'s `paint-stack`) or as it is painted again here, and the
//!      linker's symbols.
//! Out: bytes of statics, and bytes of stack at its deepest.
//!
//! Why here: the only file that touches raw memory, so that its safety argument stands beside it.

#![allow(unsafe_code)]

use core::arch::asm;
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
    (&raw const _stack_start).addr() - deepest()
}

/// Bytes of stack that `work` needs at its deepest, its own frame included and its caller's not.
///
/// Exact as [`stack_bytes_max`], which means nothing any more after this.
#[inline(never)]
pub fn stack_bytes_of(work: impl FnOnce()) -> usize {
    let top = pointer();
    paint_below(top);
    frame_of(work);
    top - deepest()
}

/// A frame of its own, so that no variable of `work` becomes one of the caller's.
#[inline(never)]
fn frame_of(work: impl FnOnce()) {
    work();
}

/// Address of the lowest word that was written since the stack was painted.
fn deepest() -> usize {
    let mut word = &raw const _stack_end;
    // SAFETY: every address from `_stack_end` up to `_stack_start` is RAM that the linker script reserves for the
    // stack; both symbols are 4-byte aligned (asserted by link.x). The reads are volatile because the compiler knows
    // nothing of this memory, and nothing writes to it meanwhile: the words above the stack pointer stay as they are.
    while word < &raw const _stack_start && unsafe { ptr::read_volatile(word) } == STACK_PAINT_VALUE
    {
        word = word.wrapping_add(1);
    }
    word.addr()
}

/// The stack pointer.
#[inline(always)]
fn pointer() -> usize {
    let address: usize;
    // SAFETY: reads a register and nothing else.
    unsafe { asm!("mov {}, sp", out(reg) address, options(nomem, nostack, preserves_flags)) };
    address
}

/// Paints the unused stack, from its end up to `top`.
#[inline(always)]
fn paint_below(top: usize) {
    let mut word = (&raw const _stack_end).cast_mut();
    while word.addr() < top {
        // SAFETY: the word lies in the stack's memory (see `deepest`) and below the stack pointer, where this
        // architecture keeps nothing; inlined, and without a call, so that no frame lies there either.
        unsafe { ptr::write_volatile(word, STACK_PAINT_VALUE) };
        word = word.wrapping_add(1);
    }
}
