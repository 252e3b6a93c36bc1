
@ A pointwise convolution to eight output channels. Sums of four pixels: q8 to q15; values: q0 to q3, one register for
@ each pixel; weights: q4 to q7.
@
@ r0 structure, r1 operand, r2 weights, r3 operand of a channel, r4 channels left / 8, r5 bytes from the third pixel of a
@ channel to the first of the next, r6 residual or 0, r7 output, r8 pixels left, r9 and r10 bytes between pixels of
@ residual and output, r11 bias, r12 activation, lr first weights.

@ Adds the products of four channels and loads the next four if \more.
.macro four_channels more
    products_of_4 q4, q5, d0[0], d2[0], d4[0], d6[0]
    vld1.32 {d8-d11}, [r2]!
    products_of_4 q6, q7, d0[1], d2[1], d4[1], d6[1]
    vld1.32 {d12-d15}, [r2]!
    products_of_4 q4, q5, d1[0], d3[0], d5[0], d7[0]
    .if \more
    vld1.32 {d8-d11}, [r2]!
    .endif
    products_of_2 0, q6, q7, d1[1], d3[1]
    .if \more
    vld1.32 {d0-d3}, [r3]!
    .endif
    products_of_2 2, q6, q7, d5[1], d7[1]
    .if \more
    vld1.32 {d4-d7}, [r3], r5
    vld1.32 {d12-d15}, [r2]!
    .endif
.endm

function pointwise
    ldr r1, [r0]
    ldr lr, [r0, #4]
    ldr r11, [r0, #8]
    ldr r12, [r0, #16]
    ldr r6, [r0, #20]
    ldr r7, [r0, #24]
    ldr r8, [r0, #28]
    ldr r5, [r0, #36]
    ldr r9, [r0, #40]
    ldr r10, [r0, #44]
    sub r5, r5, #32
    subs r8, r8, #4
    blo 6f
1:  mov r3, r1
    mov r2, lr
    ldr r4, [r0, #32]
    add r1, r1, #64
    vld1.32 {d0-d3}, [r3]!
    cmp r6, #0
    bne 2f
    vld1.32 {d16-d19}, [r11]
    vld1.32 {d20-d23}, [r11]
    vld1.32 {d24-d27}, [r11]
    vld1.32 {d28-d31}, [r11]
    b 3f
2:  vld1.32 {d8-d11}, [r11]
    vld1.32 {d16-d19}, [r6], r9
    vld1.32 {d20-d23}, [r6], r9
    vld1.32 {d24-d27}, [r6], r9
    vld1.32 {d28-d31}, [r6], r9
    vadd.f32 q8, q8, q4
    vadd.f32 q9, q9, q5
    vadd.f32 q10, q10, q4
    vadd.f32 q11, q11, q5
    vadd.f32 q12, q12, q4
    vadd.f32 q13, q13, q5
    vadd.f32 q14, q14, q4
    vadd.f32 q15, q15, q5
3:  vld1.32 {d8-d11}, [r2]!
    vld1.32 {d4-d7}, [r3], r5
    vld1.32 {d12-d15}, [r2]!
    subs r4, r4, #1
    beq 5f
4:  four_channels 1
    four_channels 1
    subs r4, r4, #1
    bne 4b
5:  four_channels 1
    four_channels 0
    finish 4
    subs r8, r8, #4
    bhs 1b
6:  adds r8, r8, #4
    beq 9f
    @ The pixels that are left, one at a time. Products are added in the same order, because a pixel must have the same bits
    @ however rows are divided among threads.
    add r5, r5, #32
7:  mov r3, r1
    mov r2, lr
    ldr r4, [r0, #32]
    add r1, r1, #16
    lsl r4, r4, #1
    vld1.32 {d16-d19}, [r11]
    cmp r6, #0
    beq 8f
    vld1.32 {d20-d23}, [r6], r9
    vadd.f32 q8, q8, q10
    vadd.f32 q9, q9, q11
8:  vld1.32 {d0-d1}, [r3], r5
    vld1.32 {d8-d11}, [r2]!
    vld1.32 {d12-d15}, [r2]!
    vmla.f32 q8, q4, d0[0]
    vmla.f32 q9, q5, d0[0]
    vld1.32 {d8-d11}, [r2]!
    vmla.f32 q8, q6, d0[1]
    vmla.f32 q9, q7, d0[1]
    vld1.32 {d12-d15}, [r2]!
    vmla.f32 q8, q4, d1[0]
    vmla.f32 q9, q5, d1[0]
    vmla.f32 q8, q6, d1[1]
    vmla.f32 q9, q7, d1[1]
    subs r4, r4, #1
    bne 8b
    finish 1
    subs r8, r8, #1
    bne 7b
9:  end_function pointwise
