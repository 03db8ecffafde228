//! Kernels for Cortex-M3, and for Armv8-M mainline whose processor nobody named: Thumb-2 without DSP.
//!
//! In:  blocks and quads as `kernel.rs` describes them.
//! Out: the sums of [`portable`](super::portable), bit for bit; firmware-sim's `check_kernels` compares them.
//!
//! Why here: SXTB takes any byte of a word, SBFX any run of bits, MLA multiplies and adds: two instructions a product.
//! Going column by column needs one activation at a time, so that the words of four rows fit and come in one load.
//!
//! # Cost
//! Instructions a tile: `w8a16` and `w8a8` 38, pairs twice that (two passes: registers for two frames are missing),
//! `w4a8` 78 and 37 a group.
//!
//! Source: Armv7-M Architecture Reference Manual, A7.7.

#![allow(unsafe_code)]

use core::arch::global_asm;

// Registers of all kernels:
//   r0 tile  r1 quad  r2 activation  r3 weight  r4-r7 words of the rows  r8-r11 sums  r12 end of the loop
// `w8a16` and `w8a8` do two tiles a turn; an odd number of tiles enters in the middle. `stride` is 8 where the quads of
// two frames alternate.
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
    .endm

    .macro karakuri_armv7m_end name
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
        push    {r3-r11, lr}
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
        pop     {r3-r11, pc}
        karakuri_armv7m_end \name
    .endm

    @ One frame after the other: the second frame's quads and sums follow the first's
    .macro karakuri_armv7m_pair name, frame
        karakuri_armv7m_begin \name
        push    {r0-r4, lr}
        bl      \frame
        pop     {r0-r3}
        adds    r1, #8
        adds    r3, #16
        bl      \frame
        pop     {r4, pc}
        karakuri_armv7m_end \name
    .endm

    karakuri_armv7m_w8 karakuri_w8a16, karakuri_armv7m_w8a16_tile, 0
    karakuri_armv7m_w8 karakuri_armv7m_w8a16_frame, karakuri_armv7m_w8a16_tile, 8
    karakuri_armv7m_w8 karakuri_w8a8, karakuri_armv7m_w8a8_tile, 0
    karakuri_armv7m_w8 karakuri_armv7m_w8a8_frame, karakuri_armv7m_w8a8_tile, 8
    karakuri_armv7m_pair karakuri_w8a16_pair, karakuri_armv7m_w8a16_frame
    karakuri_armv7m_pair karakuri_w8a8_pair, karakuri_armv7m_w8a8_frame

    @ `w4a8`: r12 ends the group and not the tiles, lr points to the scales; stack: end of the tiles, sums in memory.
    @ Low half of a word << 4k: its lowest 16 - 4k bits, and the activation << 4k instead. High half: 16 bits from bit
    @ 16 - 4k.
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

    karakuri_armv7m_begin karakuri_w4a8
        push    {r3-r11, lr}
        ldr     lr, [sp, #40]
        add     r2, r0, r2, lsl #4
        push    {r2}
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
        add     sp, #4
        pop     {r3-r11, pc}
    karakuri_armv7m_end karakuri_w4a8
"#,
    options(raw)
);
