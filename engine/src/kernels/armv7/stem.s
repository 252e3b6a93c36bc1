
@ One row of the first convolution, to sixteen output channels, two pixels at a time.
@
@ r0 structure, r1 bytes from the beginning of a row to the first pixel, r2 weights, r3 and r4 values of two pixels, r5
@ bytes from one window to the next, r6 counter, r7 output, r8 pixels left, r9 pointers to rows, r10 bytes from the second
@ half of a pixel of the output to the next pixel, r11 bytes of a value, r12 activation, lr rows left.

.macro windows pixels
    ldr r2, [r0, #8]
    start_sums \pixels
    ldr r2, [r0, #4]
    ldr r9, [r0]
    ldr lr, [r0, #28]
.Lrow\@:
    ldr r3, [r9], #4
    ldr r6, [r0, #32]
    add r3, r3, r1
    add r4, r3, r5
    first_products \pixels
    cmp r6, #0
    beq .Lodd\@
.Lpair\@:
    products \pixels, 0, r11, 1
    products \pixels, 1, r11, 1
    subs r6, r6, #1
    bne .Lpair\@
.Lodd\@:
    ldr r6, [r0, #36]
    cmp r6, #0
    beq .Llast\@
    products \pixels, 0, r11, 1
    vmov q0, q2
    vmov q1, q3
.Llast\@:
    products \pixels, 0, r11, 0
    subs lr, lr, #1
    bne .Lrow\@
    add r1, r1, r5
    .if \pixels == 2
    add r1, r1, r5
    .endif
    finish \pixels
.endm

function stem
    ldr r12, [r0, #16]
    ldr r7, [r0, #20]
    ldr r8, [r0, #24]
    ldr r5, [r0, #40]
    ldr r10, [r0, #44]
    sub r10, r10, #32
    mov r1, #0
    mov r11, #4
    subs r8, r8, #2
    blo 2f
1:  windows 2
    subs r8, r8, #2
    bhs 1b
2:  adds r8, r8, #2
    beq 3f
    windows 1
3:  end_function stem
