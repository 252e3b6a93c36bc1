
@ A pointwise convolution to sixteen output channels, two pixels at a time.
@
@ r0 structure, r1 operand, r2 weights, r3 and r4 values of two pixels, r5 bytes from the fourth channel of a vector to the
@ next vector, r6 residual or 0, r7 output, r8 pixels left, r9 and r10 bytes from the second half of a pixel of residual and
@ output to the next pixel, r11 bytes of a value, r12 activation, lr channels left / 16.

.macro four_channels pixels, more
    products \pixels, 0, r11, 1
    products \pixels, 1, r11, 1
    products \pixels, 0, r5, 1
    products \pixels, 1, r11, \more
.endm

.macro sixteen_channels pixels, more
    four_channels \pixels, 1
    four_channels \pixels, 1
    four_channels \pixels, 1
    four_channels \pixels, \more
.endm

@ Pixels are added up in the same order whether they are alone or in pairs, because a pixel must have the same bits however
@ rows are divided among threads.
.macro pointwise_pixels pixels
    ldr r2, [r0, #8]
    cmp r6, #0
    bne .Lresidual\@
    start_sums \pixels
    b .Lproducts\@
.Lresidual\@:
    vld1.32 {d8-d11}, [r2]!
    vld1.32 {d12-d15}, [r2]
    vld1.32 {d16-d19}, [r6]!
    vld1.32 {d20-d23}, [r6], r9
    vadd.f32 q8, q8, q4
    vadd.f32 q9, q9, q5
    vadd.f32 q10, q10, q6
    vadd.f32 q11, q11, q7
    .if \pixels == 2
    vld1.32 {d24-d27}, [r6]!
    vld1.32 {d28-d31}, [r6], r9
    vadd.f32 q12, q12, q4
    vadd.f32 q13, q13, q5
    vadd.f32 q14, q14, q6
    vadd.f32 q15, q15, q7
    .endif
.Lproducts\@:
    ldr r2, [r0, #4]
    ldr lr, [r0, #32]
    mov r3, r1
    add r4, r1, #16
    first_products \pixels
    add r1, r1, #16 * \pixels
    subs lr, lr, #1
    beq .Llast\@
.Lmore\@:
    sixteen_channels \pixels, 1
    subs lr, lr, #1
    bne .Lmore\@
.Llast\@:
    sixteen_channels \pixels, 0
    finish \pixels
.endm

function pointwise
    ldr r1, [r0]
    ldr r12, [r0, #16]
    ldr r6, [r0, #20]
    ldr r7, [r0, #24]
    ldr r8, [r0, #28]
    ldr r5, [r0, #36]
    ldr r9, [r0, #40]
    ldr r10, [r0, #44]
    sub r5, r5, #12
    sub r9, r9, #32
    sub r10, r10, #32
    mov r11, #4
    subs r8, r8, #2
    blo 2f
1:  pointwise_pixels 2
    subs r8, r8, #2
    bhs 1b
2:  adds r8, r8, #2
    beq 3f
    pointwise_pixels 1
3:  end_function pointwise
