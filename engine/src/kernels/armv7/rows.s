
@ Sums of weighted rows, two rows and eight columns at a time. r0 points at `Rows` in mod.rs.
@
@ r1 rows, r2 factors, r3 rows left, r4 bytes of a row, r5 and r6 two rows, r7 sums, r8 columns left. q0 and q1 factors.

function rows
    ldr r1, [r0, #4]
    ldr r2, [r0, #8]
    ldr r3, [r0, #12]
    ldr r4, [r0, #20]
    cmp r3, #0
    beq 6f
1:  vld1.32 {d0[], d1[]}, [r2]!
    mov r5, r1
    @ The last row may stand alone. It is then added a second time, with a factor of 0.
    mov r6, r1
    vmov.i32 q1, #0
    subs r3, r3, #2
    blo 2f
    vld1.32 {d2[], d3[]}, [r2]!
    add r6, r1, r4
2:  add r1, r6, r4
    ldr r7, [r0]
    ldr r8, [r0, #16]
    subs r8, r8, #8
    blo 4f
3:  vld1.32 {d16-d19}, [r7]
    vld1.32 {d20-d23}, [r5]!
    vld1.32 {d24-d27}, [r6]!
    vfma.f32 q8, q10, q0
    vfma.f32 q9, q11, q0
    vfma.f32 q8, q12, q1
    vfma.f32 q9, q13, q1
    vst1.32 {d16-d19}, [r7]!
    subs r8, r8, #8
    bhs 3b
4:  adds r8, r8, #8
    beq 5f
    vld1.32 {d16-d17}, [r7]
    vld1.32 {d20-d21}, [r5]
    vld1.32 {d24-d25}, [r6]
    vfma.f32 q8, q10, q0
    vfma.f32 q8, q12, q1
    vst1.32 {d16-d17}, [r7]
5:  cmp r3, #0
    bgt 1b
6:  end_function rows
