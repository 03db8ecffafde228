//! Kernels for Cortex-M3, and for Armv8-M mainline whose processor nobody named: Thumb-2 without DSP.
//!
//! In:  blocks and quads as `kernel.rs` describes them.
//! Out: the sums of [`portable`], bit for bit; `check_kernels` of firmware-sim's programs compares them.
//!
//! Why here: SXTB takes any byte and SBFX any run of bits of a word, MLA adds: two instructions a product. Going column by
//! column needs one activation at a time, so that the words of four rows come in one load. A tile takes 38
//! instructions, eight columns of `w4a8` 78.
//! Source: Armv7-M Architecture Reference Manual, A7.7.

#![allow(unsafe_code)]

use core::arch::global_asm;

use super::aligned::{nibble_tile_count, tile_count};
use super::{Quad, portable};

// Registers of all kernels:
//   r0 tile  r1 quad  r2 activation  r3 weight  r4-r7 words of the rows  r8-r11 sums  r12 end of the loop
// Two tiles a turn; an odd number of tiles enters in the middle. `stride` is 8 where two frames' quads alternate.
global_asm!(
    r#"
    .syntax unified
    .macro karakuri_armv7m_begin name
        .pushsection .text.\name, "ax", %progbits
        .p2align 2
        .global \name
        .type   \name, %function
        .thumb_func
    \name:
        push    {r3-r11, lr}
    .endm

    .macro karakuri_armv7m_end name
        pop     {r3-r11, pc}
        .size   \name, . - \name
        .popsection
    .endm

    @ four sums += r2 * what \extend makes of the four words
    .macro karakuri_armv7m_column extend, how:vararg
        \extend r3, r4, \how
        mla     r8, r3, r2, r8
        \extend r3, r5, \how
        mla     r9, r3, r2, r9
        \extend r3, r6, \how
        mla     r10, r3, r2, r10
        \extend r3, r7, \how
        mla     r11, r3, r2, r11
    .endm

    .macro karakuri_armv7m_w8a16_tile stride
        ldm     r0!, {r4-r7}
        ldrsh   r2, [r1], #8 + \stride
        karakuri_armv7m_column sxtb, ror #0
        ldrsh   r2, [r1, #-6 - \stride]
        karakuri_armv7m_column sxtb, ror #16
        ldrsh   r2, [r1, #-4 - \stride]
        karakuri_armv7m_column sxtb, ror #8
        ldrsh   r2, [r1, #-2 - \stride]
        karakuri_armv7m_column asr, #24
    .endm

    .macro karakuri_armv7m_w8a8_tile stride
        ldm     r0!, {r4-r7}
        ldrsh   r2, [r1], #8 + \stride
        karakuri_armv7m_column sxtb, ror #0
        ldrsh   r2, [r1, #-6 - \stride]
        karakuri_armv7m_column sxtb, ror #16
        ldrsh   r2, [r1, #-4 - \stride]
        karakuri_armv7m_column sxth, ror #0
        ldrsh   r2, [r1, #-2 - \stride]
        karakuri_armv7m_column asr, #16
    .endm

    .macro karakuri_armv7m_w8 name, tile, stride
        karakuri_armv7m_begin \name
        add     r12, r0, r2, lsl #4
        ldm     r3, {r8-r11}
        lsrs    r2, r2, #1
        bcs     2f
    1:  \tile  \stride
    2:  \tile  \stride
        cmp     r0, r12
        bne     1b
        ldr     r3, [sp]
        stm     r3, {r8-r11}
        karakuri_armv7m_end \name
    .endm

    karakuri_armv7m_w8 karakuri_armv7m_w8a16, karakuri_armv7m_w8a16_tile, 0
    karakuri_armv7m_w8 karakuri_armv7m_w8a16_strided, karakuri_armv7m_w8a16_tile, 8
    karakuri_armv7m_w8 karakuri_armv7m_w8a8, karakuri_armv7m_w8a8_tile, 0
    karakuri_armv7m_w8 karakuri_armv7m_w8a8_strided, karakuri_armv7m_w8a8_tile, 8
"#,
    options(raw)
);

// `w4a8`: r12 ends the group and not the tiles, lr points to the scales; stack: end of the tiles, sums in memory.
// Low half of a word << 4k: k fewer nibbles from its foot, and the activation << 4k instead. High half: 16 bits from bit
// 16 - 4k.
global_asm!(
    r#"
    .macro karakuri_armv7m_w4_low offset, shift
        ldrsh   r2, [r1, #\offset]
        lsl     r2, r2, #\shift
        karakuri_armv7m_column sbfx, #0, #16 - \shift
    .endm

    .macro karakuri_armv7m_w4_high offset, shift
        ldrsh   r2, [r1, #\offset]
        karakuri_armv7m_column sbfx, #16 - \shift, #16
    .endm

    @ r2, r3 low and high word of the product
    .macro karakuri_armv7m_w4_scale sum, group_sum
        ldrh    r2, [lr], #2
        smull   r2, r3, \group_sum, r2
        add     \sum, \sum, r2, lsr #16
        add     \sum, \sum, r3, lsl #16
    .endm

    karakuri_armv7m_begin karakuri_armv7m_w4a8
        ldr     r4, [sp, #40]
        add     r3, r0, r3, lsl #4
        push    {r3, r4}
        mov     lr, r1
        mov     r1, r2
    1:  movs    r2, #0
        mov     r8, r2
        mov     r9, r2
        mov     r10, r2
        mov     r11, r2
        ldr     r3, [sp]
        add     r12, r0, #128
        cmp     r12, r3
        it      hi
        movhi   r12, r3
    2:  ldm     r0!, {r4-r7}
        ldrsh   r2, [r1], #16
        karakuri_armv7m_column sxth, ror #0
        ldrsh   r2, [r1, #-14]
        karakuri_armv7m_column asr, #16
        karakuri_armv7m_w4_low -12, 4
        karakuri_armv7m_w4_high -10, 4
        karakuri_armv7m_w4_low -8, 8
        karakuri_armv7m_w4_high -6, 8
        karakuri_armv7m_w4_low -4, 12
        karakuri_armv7m_w4_high -2, 12
        cmp     r0, r12
        bne     2b
        ldr     r12, [sp, #4]
        ldm     r12, {r4-r7}
        karakuri_armv7m_w4_scale r4, r8
        karakuri_armv7m_w4_scale r5, r9
        karakuri_armv7m_w4_scale r6, r10
        karakuri_armv7m_w4_scale r7, r11
        stm     r12, {r4-r7}
        ldr     r3, [sp]
        cmp     r0, r3
        bne     1b
        add     sp, #8
    karakuri_armv7m_end karakuri_armv7m_w4a8
"#,
    options(raw)
);

unsafe extern "C" {
    fn karakuri_armv7m_w8a16(
        tiles: *const u8,
        quads: *const Quad,
        count: usize,
        sums: *mut [i32; 4],
    );
    fn karakuri_armv7m_w8a16_strided(
        tiles: *const u8,
        quads: *const Quad,
        count: usize,
        sums: *mut [i32; 4],
    );
    fn karakuri_armv7m_w8a8(
        tiles: *const u8,
        quads: *const Quad,
        count: usize,
        sums: *mut [i32; 4],
    );
    fn karakuri_armv7m_w8a8_strided(
        tiles: *const u8,
        quads: *const Quad,
        count: usize,
        sums: *mut [i32; 4],
    );
    fn karakuri_armv7m_w4a8(
        tiles: *const u8,
        scales: *const u8,
        quads: *const Quad,
        count: usize,
        sums: *mut [i32; 4],
    );
}

// SAFETY, for all calls below: `tile_count` is at least 1, the tiles are word-aligned and `count` of them and as many
// quads (for nibbles twice as many, and their groups' scales) are inside the slices; the loops end exactly there. Sums
// are an exclusive borrow. The functions keep the procedure call standard: r4 to r11 and sp are restored, nothing but
// their own stack and the sums is written.

/// [`portable::w8a16`] in assembly.
pub fn w8a16(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    let Some(count) = tile_count(tiles, quads.len()) else {
        return portable::w8a16(tiles, quads, sums);
    };
    unsafe { karakuri_armv7m_w8a16(tiles.as_ptr(), quads.as_ptr(), count, sums) }
}

/// [`portable::w8a8`] in assembly.
pub fn w8a8(tiles: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    let Some(count) = tile_count(tiles, quads.len()) else {
        return portable::w8a8(tiles, quads, sums);
    };
    unsafe { karakuri_armv7m_w8a8(tiles.as_ptr(), quads.as_ptr(), count, sums) }
}

/// [`portable::w8a16_pair`] in two passes: there are too few registers for two frames at once.
pub fn w8a16_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    let Some(count) = tile_count(tiles, quads.len()) else {
        return portable::w8a16_pair(tiles, quads, sums);
    };
    for (frame, sums) in sums.iter_mut().enumerate() {
        let quads = quads.as_ptr().cast::<Quad>().wrapping_add(frame);
        unsafe { karakuri_armv7m_w8a16_strided(tiles.as_ptr(), quads, count, sums) }
    }
}

/// [`portable::w8a8_pair`] in two passes, as [`w8a16_pair`].
pub fn w8a8_pair(tiles: &[u8], quads: &[[Quad; 2]], sums: &mut [[i32; 4]; 2]) {
    let Some(count) = tile_count(tiles, quads.len()) else {
        return portable::w8a8_pair(tiles, quads, sums);
    };
    for (frame, sums) in sums.iter_mut().enumerate() {
        let quads = quads.as_ptr().cast::<Quad>().wrapping_add(frame);
        unsafe { karakuri_armv7m_w8a8_strided(tiles.as_ptr(), quads, count, sums) }
    }
}

/// [`portable::w4a8`] in assembly.
pub fn w4a8(tiles: &[u8], scales: &[u8], quads: &[Quad], sums: &mut [i32; 4]) {
    let Some(count) = nibble_tile_count(tiles, scales, quads.len()) else {
        return portable::w4a8(tiles, scales, quads, sums);
    };
    let (tiles, scales) = (tiles.as_ptr(), scales.as_ptr());
    unsafe { karakuri_armv7m_w4a8(tiles, scales, quads.as_ptr(), count, sums) }
}
