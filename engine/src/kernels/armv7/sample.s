
@ Samples of a line, four at a time. r0 points at `Sampling` in sample.rs.
@
@ r2 bytes of a row, r3 output, r4 groups left, r5 to r8 addresses of the top left pixels, r9 bytes of a sample. q4 scale, q5
@ the sum of two weights, q8 and q9 columns and rows of four samples, q10 and q11 steps to the next four, q12 bytes of a row,
@ q13 address of the pixels, q14 zeros, q15 white.

@ Computes two samples. d0 holds the weights of right pixels, d1 those of lower pixels, d2 of left and d3 of upper ones.
.macro two_samples first, second, first_pixel, second_pixel
    vld1.16 {d4-d5}, [\first_pixel], r2
    vld1.16 {d12-d13}, [\second_pixel], r2
    vld1.16 {d6-d7}, [\first_pixel]
    vld1.16 {d14-d15}, [\second_pixel]
    vmul.i16 q2, q2, d3[\first]
    vmul.i16 q6, q6, d3[\second]
    vmla.i16 q2, q3, d1[\first]
    vmla.i16 q6, q7, d1[\second]
    vmull.s16 q3, d5, d0[\first]
    vmull.s16 q7, d13, d0[\second]
    vmlal.s16 q3, d4, d2[\first]
    vmlal.s16 q7, d12, d2[\second]
    vmax.s32 q3, q3, q14
    vmax.s32 q7, q7, q14
    vmin.s32 q3, q3, q15
    vmin.s32 q7, q7, q15
    vcvt.f32.s32 q3, q3
    vcvt.f32.s32 q7, q7
    vmul.f32 q3, q3, q4
    vmul.f32 q7, q7, q4
.endm

function sample
    vld1.32 {d16-d19}, [r0]!
    vld1.32 {d20[], d21[]}, [r0]!
    vld1.32 {d22[], d23[]}, [r0]!
    vld1.32 {d24[], d25[]}, [r0]!
    vld1.32 {d26[], d27[]}, [r0]!
    vld1.32 {d8[], d9[]}, [r0]!
    vld1.32 {d30[], d31[]}, [r0]!
    ldm r0, {r3, r4}
    vmov.32 r2, d24[0]
    vmov.i32 q14, #0
    vmov.i16 q5, #32
    mov r9, #12
    cmp r4, #0
    beq 2f
    @ A position is in 1/65536 pixel, and a pixel takes 8 bytes.
1:  vshr.s32 q2, q8, #13
    vshr.s32 q3, q9, #16
    vbic.i32 q2, #7
    vmovn.i32 d0, q8
    vmla.i32 q2, q3, q12
    vmovn.i32 d1, q9
    vadd.i32 q2, q2, q13
    vshr.u16 q0, q0, #11
    vmov r5, r6, d4
    vmov r7, r8, d5
    vsub.i16 q1, q5, q0
    vadd.i32 q8, q8, q10
    vadd.i32 q9, q9, q11
    @ A store also writes one value after its sample, which the next store overwrites. No value need follow the fourth one.
    two_samples 0, 1, r5, r6
    vst1.32 {d6-d7}, [r3], r9
    vst1.32 {d14-d15}, [r3], r9
    two_samples 2, 3, r7, r8
    vst1.32 {d6-d7}, [r3], r9
    vst1.32 {d14}, [r3]!
    vst1.32 {d15[0]}, [r3]!
    subs r4, r4, #1
    bne 1b
2:  end_function sample
