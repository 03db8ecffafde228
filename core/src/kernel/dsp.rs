//! The loops in assembly for cores with the DSP extension: Armv7E-M (M4, M7), and Armv8-M that has it (M33).
//!
//! In:  as for [`portable`](super::portable), whose results these equal bit for bit.
//! Out: the same sums, with 2.4 (`w8a16`) to 7.5 (`w4a8`) times fewer instructions than portable Rust.
//!
//! Why here: a compiler spills the sums or the pointers of these loops; written by hand, all of them fit into r0 to r12
//! and lr. `SMLAD` multiplies two pairs of halfwords and adds both products; `SXTB16` extends bytes 0 and 2 of a word
//! to halfwords, or bytes 1 and 3 with `ror 8`.
//!
//! # Entry into the unrolled loops
//! A loop of 8 turns is entered so that `count % 8` turns are left (`TBH` jumps by a table of offsets, and all turns
//! have the same size), then runs `count / 8` times as a whole. No turns left means a jump to the test at the end,
//! which serves `count == 0`, too.
//!
//! # Safety
//! That of [`assembly`](super::assembly): `LDM` and `LDRD` want words, and nothing is read beyond `count` tiles and
//! quads. At most 64 bytes of stack are used.
//!
//! `.cpu` is needed because link-time optimisation looks at the text without the compiler's own `target-cpu`.
//!
//! Source: Armv7-M Architecture Reference Manual (Arm DDI 0403), A7; AAPCS32.

#![allow(unsafe_code)]

mod pair;
mod w4a8;

use core::arch::global_asm;

// r0 tiles, r1 quads, r2 tiles left, r3 bytes 1 and 3, r4-r7 weights, r8 x0 and x2, r9 x1 and x3, r10-r12 and lr sums.
// Stack: where the sums belong. Every register is in use: two quads at a time (a load less per two tiles) do not fit.
global_asm!(
    r#"
    .macro karakuri_row sum, weights
    sxtb16  r3, \weights, ror #8
    sxtb16  \weights, \weights
    smlad   \sum, r3, r9, \sum
    smlad   \sum, \weights, r8, \sum
    .endm

    .cpu    cortex-m4
    .section .text.karakuri_w8a16, "ax", %progbits
    .global karakuri_w8a16
    .type   karakuri_w8a16, %function
    .thumb_func
karakuri_w8a16:
    push    {r3-r11, lr}
    ldm     r3, {r10, r11, r12, lr}
    and     r3, r2, #7
    tbh     [pc, r3, lsl #1]
2:  .irp    left, 0, 1, 2, 3, 4, 5, 6, 7
    .hword  (4f - 2b - \left * ((4f - 3f) / 8)) / 2
    .endr
3:  .rept   8
    ldm     r0!, {r4-r7}
    ldm     r1!, {r8, r9}
    karakuri_row r10, r4
    karakuri_row r11, r5
    karakuri_row r12, r6
    karakuri_row lr, r7
    .endr
4:  subs    r2, r2, #8
    bhs     3b
    pop     {r3}
    stm     r3, {r10, r11, r12, lr}
    pop     {r4-r11, pc}
    .size   karakuri_w8a16, . - karakuri_w8a16
    .purgem karakuri_row
    .text
    "#,
    options(raw)
);

// r0 tiles, r1 quads, r4-r7 weights, r8 d0 and d2, r9 x1 and x3, r10 and r11 those of a second quad, r2, r3, r12 and lr
// sums. Stack: where the sums belong, end of the quads. No register for it: it is needed once in 8 tiles, and two
// quads in one load save more than its own load costs.
global_asm!(
    r#"
    .macro karakuri_row sum, weights, low, high
    smlad   \sum, \weights, \high, \sum
    sxtb16  \weights, \weights
    smlad   \sum, \weights, \low, \sum
    .endm
    .macro karakuri_tile low, high
    ldm     r0!, {r4-r7}
    karakuri_row r2, r4, \low, \high
    karakuri_row r3, r5, \low, \high
    karakuri_row r12, r6, \low, \high
    karakuri_row lr, r7, \low, \high
    .endm

    .cpu    cortex-m4
    .section .text.karakuri_w8a8, "ax", %progbits
    .global karakuri_w8a8
    .type   karakuri_w8a8, %function
    .thumb_func
karakuri_w8a8:
    push    {r4-r11, lr}
    add     r12, r1, r2, lsl #3
    push    {r3, r12}
    ubfx    r10, r2, #1, #2
    tst     r2, #1
    ldm     r3, {r2, r3, r12, lr}
    beq     2f
    ldm     r1!, {r8, r9}
    karakuri_tile r8, r9
2:  tbh     [pc, r10, lsl #1]
3:  .irp    left, 0, 1, 2, 3
    .hword  (5f - 3b - \left * ((5f - 4f) / 4)) / 2
    .endr
4:  .rept   4
    ldm     r1!, {r8-r11}
    karakuri_tile r8, r9
    karakuri_tile r10, r11
    .endr
5:  ldr     r4, [sp, #4]
    cmp     r1, r4
    blo     4b
    pop     {r4, r5}
    stm     r4, {r2, r3, r12, lr}
    pop     {r4-r11, pc}
    .size   karakuri_w8a8, . - karakuri_w8a8
    .purgem karakuri_tile
    .purgem karakuri_row
    .text
    "#,
    options(raw)
);
