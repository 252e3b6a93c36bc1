
@ One row of the first convolution, to eight output channels. The products are computed as in a pointwise convolution whose
@ channels are the values of a row of the window.
@
@ r0 structure, r1 to r4 values of four pixels, r5 weights, r6 counter, r7 output, r8 pixels left, r9 pointers to rows, r10
@ bytes between pixels of the output, r11 bytes from the beginning of a row to the first pixel, r12 activation, lr rows
@ left.

@ Adds the products of four values of each pixel.
.macro four_values
    vld1.32 {d0-d1}, [r1]!
    vld1.32 {d8-d11}, [r5]!
    vld1.32 {d2-d3}, [r2]!
    vld1.32 {d4-d5}, [r3]!
    vld1.32 {d6-d7}, [r4]!
    vld1.32 {d12-d15}, [r5]!
    products_of_4 q4, q5, d0[0], d2[0], d4[0], d6[0]
    vld1.32 {d8-d11}, [r5]!
    products_of_4 q6, q7, d0[1], d2[1], d4[1], d6[1]
    vld1.32 {d12-d15}, [r5]!
    products_of_4 q4, q5, d1[0], d3[0], d5[0], d7[0]
    products_of_4 q6, q7, d1[1], d3[1], d5[1], d7[1]
.endm

function stem
    ldr r12, [r0, #16]
    ldr r7, [r0, #20]
    ldr r8, [r0, #24]
    ldr r10, [r0, #44]
    mov r11, #0
    subs r8, r8, #4
    blo 6f
1:  ldr r4, [r0, #8]
    ldr r5, [r0, #4]
    ldr r9, [r0]
    ldr lr, [r0, #28]
    vld1.32 {d16-d19}, [r4]
    vld1.32 {d20-d23}, [r4]
    vld1.32 {d24-d27}, [r4]
    vld1.32 {d28-d31}, [r4]
2:  ldr r1, [r9], #4
    ldr r4, [r0, #40]
    ldr r6, [r0, #32]
    add r1, r1, r11
    add r2, r1, r4
    add r3, r2, r4
    add r4, r3, r4
    cmp r6, #0
    beq 4f
3:  four_values
    subs r6, r6, #1
    bne 3b
4:  ldr r6, [r0, #36]
    cmp r6, #0
    beq 5f
10: vld1.32 {d0[0]}, [r1]!
    vld1.32 {d8-d11}, [r5]!
    vld1.32 {d2[0]}, [r2]!
    vld1.32 {d4[0]}, [r3]!
    vld1.32 {d6[0]}, [r4]!
    products_of_4 q4, q5, d0[0], d2[0], d4[0], d6[0]
    subs r6, r6, #1
    bne 10b
5:  subs lr, lr, #1
    bne 2b
    ldr r4, [r0, #40]
    add r11, r11, r4, lsl #2
    finish 4
    subs r8, r8, #4
    bhs 1b
6:  adds r8, r8, #4
    beq 9f
    @ The pixels that are left, one at a time.
7:  ldr r4, [r0, #8]
    ldr r5, [r0, #4]
    ldr r9, [r0]
    ldr lr, [r0, #28]
    ldr r2, [r0, #32]
    ldr r3, [r0, #36]
    add r3, r3, r2, lsl #2
    vld1.32 {d16-d19}, [r4]
8:  ldr r1, [r9], #4
    add r1, r1, r11
    mov r6, r3
0:  vld1.32 {d0[0]}, [r1]!
    vld1.32 {d8-d11}, [r5]!
    vmla.f32 q8, q4, d0[0]
    vmla.f32 q9, q5, d0[0]
    subs r6, r6, #1
    bne 0b
    subs lr, lr, #1
    bne 8b
    ldr r4, [r0, #40]
    add r11, r11, r4
    finish 1
    subs r8, r8, #1
    bne 7b
9:  end_function stem
