
@ Sums of weighted rows of 8-bit numbers, eight columns at a time: for each eight columns, all rows. r0 points at `ByteRows`
@ in mod.rs.
@
@ r1 rows, r2 factors, r3 rows left, r4 bytes of a row, r5 a row, r6 factors left, r7 sums, r8 eights left.
@ q8 and q9 sums, q0 factor.

function byte_rows
    ldr r7, [r0]
    ldr r1, [r0, #4]
    ldr r8, [r0, #16]
    lsl r4, r8, #3
    ldr r9, [r0, #12]
    cmp r9, #0
    cmpne r8, #0
    beq 3f
1:  mov r5, r1
    ldr r6, [r0, #8]
    mov r3, r9
    vld1.32 {d16-d19}, [r7]
2:  vld1.8 {d20}, [r5], r4
    vld1.32 {d0[], d1[]}, [r6]!
    vmovl.s8 q11, d20
    vmovl.s16 q12, d22
    vmovl.s16 q13, d23
    vcvt.f32.s32 q12, q12
    vcvt.f32.s32 q13, q13
    vfma.f32 q8, q12, q0
    vfma.f32 q9, q13, q0
    subs r3, r3, #1
    bne 2b
    vst1.32 {d16-d19}, [r7]!
    add r1, r1, #8
    subs r8, r8, #1
    bne 1b
3:  end_function byte_rows
