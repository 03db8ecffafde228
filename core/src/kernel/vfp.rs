//! The `f16` kernel for hard-float targets: VCVTB and VCVTT widen binary16, VMLA multiplies and adds.
//!
//! In:  weights of four rows, column by column, in binary16; activations in f32.
//! Out: the sums of [`portable`](super::portable), bit for bit; firmware-sim's `check_kernels` compares them.
//!
//! Why here: VMLA.F32 rounds the product and then the sum, as portable Rust does; VFMA, with one rounding, would give
//! other bits. Widening is exact, subnormals included. All this holds with the FPSCR as it is after reset: round to
//! nearest, IEEE binary16, no flush to zero; who sets its FZ, RMode or AHP bits gets other numbers from every kernel.
//! Eight columns of four rows take 68 instructions.
//! Source: Armv7-M Architecture Reference Manual, A7.7 (VCVTB, VMLA) and A2.5 (FPSCR).

#![allow(unsafe_code)]

use core::arch::global_asm;

use super::assembly::run;

// Registers:
//   r0 weight  r1 activation  r2 columns left  r3 sums in memory
//   s0-s3 sums  s4-s7 weights of a column in f32  s8-s15 activations  s16-s31 weights of eight columns
// `.fpu`: the assembler does not see which FPU the target has; this is the least of all, a part of the others.
global_asm!(
    r#"
    .syntax unified
    .fpu    fpv4-sp-d16
    .macro karakuri_vfp_column x, rows01, rows23
        vcvtb.f32.f16 s4, \rows01
        vcvtt.f32.f16 s5, \rows01
        vcvtb.f32.f16 s6, \rows23
        vcvtt.f32.f16 s7, \rows23
        vmla.f32 s0, s4, \x
        vmla.f32 s1, s5, \x
        vmla.f32 s2, s6, \x
        vmla.f32 s3, s7, \x
    .endm

    .pushsection .text.karakuri_vfp_f16, "ax", %progbits
    .p2align 2
    .global karakuri_vfp_f16
    .type   karakuri_vfp_f16, %function
    .thumb_func
    karakuri_vfp_f16:
        vpush   {s16-s31}
        vldm    r3, {s0-s3}
        subs    r2, r2, #8
        blo     2f
    1:  vldmia  r1!, {s8-s15}
        vldmia  r0!, {s16-s31}
        karakuri_vfp_column s8, s16, s17
        karakuri_vfp_column s9, s18, s19
        karakuri_vfp_column s10, s20, s21
        karakuri_vfp_column s11, s22, s23
        karakuri_vfp_column s12, s24, s25
        karakuri_vfp_column s13, s26, s27
        karakuri_vfp_column s14, s28, s29
        karakuri_vfp_column s15, s30, s31
        subs    r2, r2, #8
        bhs     1b
    2:  adds    r2, r2, #8
        beq     4f
    3:  vldmia  r1!, {s8}
        vldmia  r0!, {s16, s17}
        karakuri_vfp_column s8, s16, s17
        subs    r2, r2, #1
        bne     3b
    4:  vstm    r3, {s0-s3}
        vpop    {s16-s31}
        bx      lr
    .size   karakuri_vfp_f16, . - karakuri_vfp_f16
    .popsection
"#,
    options(raw)
);

unsafe extern "C" {
    fn karakuri_vfp_f16(weights: *const u8, x: *const f32, columns: usize, sums: &mut [f32; 4]);
}

/// Bytes of a column of four binary16 weights.
const COLUMN_BYTES: usize = 8;

/// [`portable::f16`](super::portable::f16): 68 instructions for eight columns, 12 for each that is left.
pub fn f16(weights: &[u8], activations: &[f32], sums: &mut [f32; 4]) {
    run::<COLUMN_BYTES, _, _>(karakuri_vfp_f16, weights, activations, sums);
}
