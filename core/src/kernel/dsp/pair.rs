//! Two frames in one pass over the weights.
//!
//! In:  as for [`portable`](super::super::portable).
//! Out: the same sums.
//!
//! Why here: an extraction serves two frames. Eight sums and their operands do not fit into 14 registers, so a call
//! goes over rows 0 and 1 first, then over rows 2 and 3: each weight is still loaded once.
//!
//! # Safety
//! As in [`dsp`](super). Rows 2 and 3 are read 8 bytes further on, up to the same end.

use core::arch::global_asm;

// r0 tiles, r1 quads, r2 tiles left, r3 bytes 1 and 3, r4-r7 quads of frame A and B, r8 and r9 weights of two rows,
// r10 and r11 their sums for frame A, r12 and lr for frame B. Stack: where the sums belong.
// The function calls its own second half for rows 0 and 1, then runs into it for rows 2 and 3.
global_asm!(
    r#"
    .macro karakuri_row_w8a16 sum_a, sum_b, weights
    sxtb16  r3, \weights, ror #8
    sxtb16  \weights, \weights
    smlad   \sum_a, r3, r5, \sum_a
    smlad   \sum_b, r3, r7, \sum_b
    smlad   \sum_a, \weights, r4, \sum_a
    smlad   \sum_b, \weights, r6, \sum_b
    .endm
    .macro karakuri_row_w8a8 sum_a, sum_b, weights
    smlad   \sum_a, \weights, r5, \sum_a
    smlad   \sum_b, \weights, r7, \sum_b
    sxtb16  \weights, \weights
    smlad   \sum_a, \weights, r4, \sum_a
    smlad   \sum_b, \weights, r6, \sum_b
    .endm

    .macro karakuri_pair name, row
    .section .text.\name, "ax", %progbits
    .global \name
    .type   \name, %function
    .thumb_func
\name:
    push    {r0-r3, lr}
    bl      2f
    pop     {r0-r3, lr}
    adds    r0, r0, #8
    adds    r3, r3, #8
2:  push    {r3-r11, lr}
    ldrd    r10, r11, [r3]
    ldrd    r12, lr, [r3, #16]
    and     r3, r2, #7
    tbh     [pc, r3, lsl #1]
3:  .irp    left, 0, 1, 2, 3, 4, 5, 6, 7
    .hword  (5f - 3b - \left * ((5f - 4f) / 8)) / 2
    .endr
4:  .rept   8
    ldm     r1!, {r4-r7}
    ldrd    r8, r9, [r0], #16
    \row    r10, r12, r8
    \row    r11, lr, r9
    .endr
5:  subs    r2, r2, #8
    bhs     4b
    pop     {r3}
    strd    r10, r11, [r3]
    strd    r12, lr, [r3, #16]
    pop     {r4-r11, pc}
    .size   \name, . - \name
    .endm

    .cpu    cortex-m4
    karakuri_pair karakuri_w8a16_pair, karakuri_row_w8a16
    karakuri_pair karakuri_w8a8_pair, karakuri_row_w8a8
    .purgem karakuri_pair
    .purgem karakuri_row_w8a8
    .purgem karakuri_row_w8a16
    .text
    "#,
    options(raw)
);
