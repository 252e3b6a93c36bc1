
@ Weighted sums of a whole map. Sums of 32 outputs: q8 to q15; a value: q0; weights: q1 to q4.
@
@ r0 structure, r1 values, r2 weights, r3 values left, r4 bias, r5 output, r6 panels left.

function dense
    ldr r2, [r0, #4]
    ldr r4, [r0, #8]
    ldr r5, [r0, #12]
    ldr r6, [r0, #20]
1:  ldr r1, [r0]
    ldr r3, [r0, #16]
    vldmia r4!, {d16-d31}
    cmp r3, #0
    beq 3f
2:  vld1.32 {d0[], d1[]}, [r1]!
    vld1.32 {d2-d5}, [r2]!
    vld1.32 {d6-d9}, [r2]!
    subs r3, r3, #1
    vfma.f32 q8, q1, q0
    vfma.f32 q9, q2, q0
    vld1.32 {d2-d5}, [r2]!
    vfma.f32 q10, q3, q0
    vfma.f32 q11, q4, q0
    vld1.32 {d6-d9}, [r2]!
    vfma.f32 q12, q1, q0
    vfma.f32 q13, q2, q0
    vfma.f32 q14, q3, q0
    vfma.f32 q15, q4, q0
    bne 2b
3:  vstmia r5!, {d16-d31}
    subs r6, r6, #1
    bne 1b
    end_function dense
