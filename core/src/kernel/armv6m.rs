//! Kernels for Cortex-M0, M0+ and M23 (Armv6-M, Armv8-M baseline): 16-bit Thumb, 32-bit products.
//!
//! In:  blocks and quads as `kernel.rs` describes them.
//! Out: the sums of [`portable`](super::portable), bit for bit; firmware-sim's `check_kernels` compares them.
//!
//! Why here: MULS and the extensions reach r0 to r7 only, but ADD reaches every register: the sums stay in r8 to r11,
//! so that pointers, activations, a word and a product fit below.
//!
//! # Cost
//! Instructions a tile: `w8a16` 67, `w8a8` 58, pairs twice that (two passes: registers for two frames are missing),
//! `w4a8` 125 and 61 a group.
//!
//! Source: Armv6-M Architecture Reference Manual, A6.7.

#![allow(unsafe_code)]

use core::arch::global_asm;

global_asm!(
    r#"
    .syntax unified
    .macro karakuri_armv6m_begin name
        .pushsection .text.\name, "ax", %progbits
        .p2align 2
        .global \name
        .type   \name, %function
        .thumb_func
    \name:
    .endm

    .macro karakuri_armv6m_end name
        .size   \name, . - \name
        .popsection
    .endm

    .macro karakuri_armv6m_save
        push    {r4-r7, lr}
        mov     r4, r8
        mov     r5, r9
        mov     r6, r10
        mov     r7, r11
        push    {r4-r7}
    .endm

    .macro karakuri_armv6m_return
        pop     {r4-r7}
        mov     r8, r4
        mov     r9, r5
        mov     r10, r6
        mov     r11, r7
        pop     {r4-r7, pc}
    .endm

    @ \sum += (signed \weight) * \x, by way of r7
    .macro karakuri_armv6m_multiply sum, extend, weight, x
        \extend r7, \weight
        muls    r7, \x, r7
        add     \sum, r7
    .endm

    @ `w8a16`, `w8a8`, and with `stride` 8 one frame of their pairs:
    @   r0 tile  r1 quad  r2-r5 the quad's halfwords in order  r6 word of a row  r7 product  r8-r11 sums
    @   r12 end of the tiles  lr sums in memory
    @ Where two tiles a turn are within reach of the branch, an odd number of tiles enters in the middle.
    .macro karakuri_armv6m_w8a16_row sum
        ldm     r0!, {r6}
        karakuri_armv6m_multiply \sum, sxtb, r6, r2
        asrs    r6, r6, #8
        karakuri_armv6m_multiply \sum, sxtb, r6, r4
        asrs    r6, r6, #8
        karakuri_armv6m_multiply \sum, sxtb, r6, r3
        asrs    r6, r6, #8
        muls    r6, r5, r6
        add     \sum, r6
    .endm

    .macro karakuri_armv6m_w8a8_row sum
        ldm     r0!, {r6}
        karakuri_armv6m_multiply \sum, sxth, r6, r4
        karakuri_armv6m_multiply \sum, sxtb, r6, r2
        asrs    r6, r6, #16
        karakuri_armv6m_multiply \sum, sxtb, r6, r3
        muls    r6, r5, r6
        add     \sum, r6
    .endm

    .macro karakuri_armv6m_tile row, stride
        ldm     r1!, {r3, r5}
        sxth    r2, r3
        asrs    r3, r3, #16
        sxth    r4, r5
        asrs    r5, r5, #16
        .if \stride
        adds    r1, #\stride
        .endif
        .irp    sum, r8, r9, r10, r11
        \row   \sum
        .endr
    .endm

    .macro karakuri_armv6m_w8 name, row, stride, tiles_a_turn
        karakuri_armv6m_begin \name
        karakuri_armv6m_save
        mov     lr, r3
        lsls    r4, r2, #4
        adds    r4, r4, r0
        mov     r12, r4
        ldm     r3!, {r4-r7}
        mov     r8, r4
        mov     r9, r5
        mov     r10, r6
        mov     r11, r7
        .if \tiles_a_turn == 2
        lsrs    r2, r2, #1
        bcs     2f
    1:  karakuri_armv6m_tile \row, \stride
        .else
    1:
        .endif
    2:  karakuri_armv6m_tile \row, \stride
        cmp     r0, r12
        bne     1b
        mov     r0, lr
        mov     r4, r8
        mov     r5, r9
        mov     r6, r10
        mov     r7, r11
        stm     r0!, {r4-r7}
        karakuri_armv6m_return
        karakuri_armv6m_end \name
    .endm

    @ One frame after the other: the second frame's quads and sums follow the first's
    .macro karakuri_armv6m_pair name, frame
        karakuri_armv6m_begin \name
        push    {r0-r4, lr}
        bl      \frame
        pop     {r0-r3}
        adds    r1, #8
        adds    r3, #16
        bl      \frame
        pop     {r4, pc}
        karakuri_armv6m_end \name
    .endm

    karakuri_armv6m_w8 karakuri_w8a16, karakuri_armv6m_w8a16_row, 0, 1
    karakuri_armv6m_w8 karakuri_armv6m_w8a16_frame, karakuri_armv6m_w8a16_row, 8, 1
    karakuri_armv6m_w8 karakuri_w8a8, karakuri_armv6m_w8a8_row, 0, 2
    karakuri_armv6m_w8 karakuri_armv6m_w8a8_frame, karakuri_armv6m_w8a8_row, 8, 2
    karakuri_armv6m_pair karakuri_w8a16_pair, karakuri_armv6m_w8a16_frame
    karakuri_armv6m_pair karakuri_w8a8_pair, karakuri_armv6m_w8a8_frame

    @ `w4a8`:
    @   r0 activations  r1-r4 words of the rows  r5, r6 two activations  r7 product  r8-r11 sums of the group
    @   r12 tile  lr end of the group  stack: scales, sums in memory, end of the tiles
    @ (sum * scale) >> 16 without a long product: high half * scale + ((low half * scale) >> 16), both fit 32 bits.
    .macro karakuri_armv6m_w4_row sum, word, last
        karakuri_armv6m_multiply \sum, sxth, \word, r5
        asrs    r7, \word, #16
        muls    r7, r6, r7
        add     \sum, r7
        .ifb    \last
        lsls    \word, \word, #4
        .endif
    .endm

    .macro karakuri_armv6m_w4_columns last
        ldm     r0!, {r5}
        asrs    r6, r5, #16
        sxth    r5, r5
        karakuri_armv6m_w4_row r8, r1, \last
        karakuri_armv6m_w4_row r9, r2, \last
        karakuri_armv6m_w4_row r10, r3, \last
        karakuri_armv6m_w4_row r11, r4, \last
    .endm

    @ r1 scales, r2 sums in memory
    .macro karakuri_armv6m_w4_scale sum, row
        ldrh    r3, [r1, #2 * \row]
        mov     r4, \sum
        uxth    r5, r4
        asrs    r4, r4, #16
        muls    r4, r3, r4
        muls    r5, r3, r5
        lsrs    r5, r5, #16
        ldr     r6, [r2, #4 * \row]
        adds    r6, r6, r4
        adds    r6, r6, r5
        str     r6, [r2, #4 * \row]
    .endm

    karakuri_armv6m_begin karakuri_w4a8
        karakuri_armv6m_save
        lsls    r2, r2, #4
        adds    r4, r2, r0
        mov     r12, r0
        mov     r0, r1
        ldr     r1, [sp, #36]
        mov     r2, r3
        mov     r3, r4
        push    {r1-r3}
    1:  movs    r4, #0
        mov     r8, r4
        mov     r9, r4
        mov     r10, r4
        mov     r11, r4
        movs    r4, #128
        add     r4, r12
        cmp     r4, r3
        bls     2f
        mov     r4, r3
    2:  mov     lr, r4
    3:  mov     r7, r12
        ldm     r7!, {r1-r4}
        mov     r12, r7
        karakuri_armv6m_w4_columns
        karakuri_armv6m_w4_columns
        karakuri_armv6m_w4_columns
        karakuri_armv6m_w4_columns last
        cmp     r12, lr
        bne     3b
        ldr     r1, [sp, #0]
        ldr     r2, [sp, #4]
        karakuri_armv6m_w4_scale r8, 0
        karakuri_armv6m_w4_scale r9, 1
        karakuri_armv6m_w4_scale r10, 2
        karakuri_armv6m_w4_scale r11, 3
        adds    r1, #8
        str     r1, [sp, #0]
        ldr     r3, [sp, #8]
        cmp     r12, r3
        beq     4f
        b       1b                      @ too far for a condition
    4:  add     sp, #12
        karakuri_armv6m_return
    karakuri_armv6m_end karakuri_w4a8
"#,
    options(raw)
);
