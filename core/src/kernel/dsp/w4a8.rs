//! Weights of 4 bits, eight in a word.
//!
//! In:  as for [`portable`](super::super::portable).
//! Out: the same sums.
//!
//! Why here: the word itself, shifted left three times, is all the unpacking there is: 7 instructions for 8 products.
//!
//! # Safety
//! As in [`dsp`](super). A group's scales are read after its last octet, those of a shorter last group, too.

use core::arch::global_asm;

// r0 tiles, r1 quads, r4-r7 weights, r8-r11 activations, r2, r3, r12 and lr sums of the group.
// Stack: the four sums of the rows, the scales, the number of octets left less 8 (negative: no whole group), then where
// the sums belong. Between groups the first six are in r4-r9, and r10 and r11 hold four scales.
// A group's first products start its sums (`SMUAD`), which saves clearing them. A last, shorter group does clear them
// and enters the same turns later on.
global_asm!(
    r#"
    .macro karakuri_row first, sum, weights
    .if     \first
    smuad   \sum, \weights, r8
    .else
    smlad   \sum, \weights, r8, \sum
    .endif
    lsls    \weights, \weights, #4
    smlad   \sum, \weights, r9, \sum
    lsls    \weights, \weights, #4
    smlad   \sum, \weights, r10, \sum
    lsls    \weights, \weights, #4
    smlad   \sum, \weights, r11, \sum
    .endm
    .macro karakuri_octet first
    ldm     r0!, {r4-r7}
    ldm     r1!, {r8-r11}
    karakuri_row \first, r2, r4
    karakuri_row \first, r3, r5
    karakuri_row \first, r12, r6
    karakuri_row \first, lr, r7
    .endm

    .cpu    cortex-m4
    .section .text.karakuri_w4a8, "ax", %progbits
    .global karakuri_w4a8
    .type   karakuri_w4a8, %function
    .thumb_func
karakuri_w4a8:
    ldr     r12, [sp]
    push    {r3-r11, lr}
    ldm     r3, {r4-r7}
    mov     r8, r12
    subs    r9, r2, #8
    push    {r4-r9}
    b       7f
3:  movs    r2, #0
    movs    r3, #0
    mov     r12, #0
    mov     lr, #0
    tbh     [pc, r9, lsl #1]
4:  .irp    left, 0, 1, 2, 3, 4, 5, 6, 7
    .hword  (6f - 4b - \left * ((6f - 5f) / 8)) / 2
    .endr
5:  karakuri_octet 1
    .rept   7
    karakuri_octet 0
    .endr
6:  ldrd    r8, r9, [sp, #16]
    ldm     sp, {r4-r7}
    ldm     r8!, {r10, r11}
    smlawb  r4, r2, r10, r4
    smlawt  r5, r3, r10, r5
    smlawb  r6, r12, r11, r6
    smlawt  r7, lr, r11, r7
    subs    r9, r9, #8
    stm     sp, {r4-r9}
7:  bge     5b
    adds    r9, r9, #8
    bgt     3b
    add     sp, sp, #24
    pop     {r3}
    stm     r3, {r4-r7}
    pop     {r4-r11, pc}
    .size   karakuri_w4a8, . - karakuri_w4a8
    .purgem karakuri_octet
    .purgem karakuri_row
    .text
    "#,
    options(raw)
);
