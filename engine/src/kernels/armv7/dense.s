
@ Weighted sums of a whole map. Sums of 32 outputs: q8 to q15; four values: q0; weights: q2 to q7.
@
@ r0 structure, r1 values, r2 weights, r3 values left, r4 bias, r5 output, r6 panels left.

.macro products_of_value value
    vld1.32 {d8-d11}, [r2]!
    vld1.32 {d12-d15}, [r2]!
    vld1.32 {d4-d7}, [r2]!
    vmla.f32 q8, q4, \value
    vmla.f32 q9, q5, \value
    vld1.32 {d8-d11}, [r2]!
    vmla.f32 q10, q6, \value
    vmla.f32 q11, q7, \value
    vmla.f32 q12, q2, \value
    vmla.f32 q13, q3, \value
    vmla.f32 q14, q4, \value
    vmla.f32 q15, q5, \value
.endm

function dense
    ldr r2, [r0, #4]
    ldr r4, [r0, #8]
    ldr r5, [r0, #12]
    ldr r6, [r0, #20]
1:  ldr r1, [r0]
    ldr r3, [r0, #16]
    vldmia r4!, {d16-d31}
    subs r3, r3, #4
    blo 3f
2:  vld1.32 {d0-d1}, [r1]!
    products_of_value d0[0]
    products_of_value d0[1]
    products_of_value d1[0]
    products_of_value d1[1]
    subs r3, r3, #4
    bhs 2b
3:  adds r3, r3, #4
    beq 5f
4:  vld1.32 {d0[0]}, [r1]!
    products_of_value d0[0]
    subs r3, r3, #1
    bne 4b
5:  vstmia r5!, {d16-d31}
    subs r6, r6, #1
    bne 1b
    end_function dense
