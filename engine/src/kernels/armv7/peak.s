
@ Multiply-adds in registers: r0 rounds with the factor whose bits are in r1. Returns the bits of the sum of all results.

function peak
    .irp sum, q8, q9, q10, q11, q12, q13, q14, q15
    vmov.f32 \sum, #1.0
    .endr
    vdup.32 q0, r1
    cmp r0, #0
    beq 2f
1:  .irp sum, q8, q9, q10, q11, q12, q13, q14, q15
    vfma.f32 \sum, \sum, q0
    .endr
    subs r0, r0, #1
    bne 1b
2:  .irp sum, q9, q10, q11, q12, q13, q14, q15
    vadd.f32 q8, q8, \sum
    .endr
    vmov.32 r0, d16[0]
    end_function peak
