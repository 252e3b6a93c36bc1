
@ One row of a depthwise 3 x 3 convolution. Weights: q0 to q8; the values of a column: q9 to q11. Each column adds to the
@ sums of all windows that cover it, so that it is loaded once.
@
@ r0 structure, r1 to r3 input rows, r4 bytes from pixel to pixel, r5 weights, r6 output, r7 and r8 counters, r9 vectors of
@ channels left, r10 bytes to the first of the channels, r11 first output of the vector, r12 largest values.

.macro load_column
    vld1.32 {d18-d19}, [r1], r4
    vld1.32 {d20-d21}, [r2], r4
    vld1.32 {d22-d23}, [r3], r4
.endm

.macro depthwise_start
    ldr r4, [r0, #12]
    ldr r5, [r0, #16]
    ldr r11, [r0, #20]
    ldr r9, [r0, #32]
    mov r10, #0
.endm

.macro vector_start
    ldm r0, {r1-r3}
    add r1, r1, r10
    add r2, r2, r10
    add r3, r3, r10
    mov r6, r11
    ldr r7, [r0, #24]
    ldr r8, [r0, #28]
    load_column
    vld1.32 {d0-d3}, [r5]!
    vld1.32 {d4-d7}, [r5]!
    vld1.32 {d8-d11}, [r5]!
    vld1.32 {d12-d15}, [r5]!
    vld1.32 {d16-d17}, [r5]!
.endm

@ Goes on with the next vector of channels, if there is one.
.macro vector_end again
    ldr r7, [r0, #36]
    add r10, r10, #16
    add r11, r11, r7
    subs r9, r9, #1
    bne \again
.endm

@ Adds a column to the three windows that cover it: \done, whose last column this is, \middle, and \next, whose first it is.
@ Then loads the next column if \more. Stores the sums in \previous, if it is given.
.macro column_of_3 more, done, middle, next, previous
    vfma.f32 \done, q9, q2
    vfma.f32 \middle, q9, q1
    vmul.f32 \next, q9, q0
    .if \more
    vld1.32 {d18-d19}, [r1], r4
    .endif
    vfma.f32 \done, q10, q5
    vfma.f32 \middle, q10, q4
    vfma.f32 \next, q10, q3
    .if \more
    vld1.32 {d20-d21}, [r2], r4
    .endif
    .ifnb \previous
    vst1.32 {\previous}, [r6]!
    .endif
    vfma.f32 \done, q11, q8
    vfma.f32 \middle, q11, q7
    vfma.f32 \next, q11, q6
    .if \more
    vld1.32 {d22-d23}, [r3], r4
    .endif
.endm

@ The last column of the row.
.macro last_column done, middle, free, previous
    column_of_3 0, \done, \middle, \free, \previous
    vst1.32 {\done}, [r6]!
    vst1.32 {\middle}, [r6]!
    b 8f
.endm

@ r7: four columns at a time, r8: columns after those; without the first two and the last one. r7 is -1 if there are two
@ columns, and -2 if there is one.
function depthwise
    depthwise_start
1:  vector_start
    vmul.f32 q12, q9, q1
    vmul.f32 q13, q9, q0
    vfma.f32 q12, q10, q4
    vfma.f32 q13, q10, q3
    vfma.f32 q12, q11, q7
    vfma.f32 q13, q11, q6
    cmp r7, #0
    blt 6f
    load_column
    column_of_3 1, q12, q13, q14
    cmp r7, #0
    beq 3f
2:  column_of_3 1, q13, q14, q15, q12
    column_of_3 1, q14, q15, q12, q13
    column_of_3 1, q15, q12, q13, q14
    column_of_3 1, q12, q13, q14, q15
    subs r7, r7, #1
    bne 2b
3:  cmp r8, #1
    bhi 4f
    beq 5f
    last_column q13, q14, q15, q12
4:  column_of_3 1, q13, q14, q15, q12
    column_of_3 1, q14, q15, q12, q13
    cmp r8, #2
    bhi 9f
    last_column q15, q12, q13, q14
9:  column_of_3 1, q15, q12, q13, q14
    last_column q12, q13, q14, q15
5:  column_of_3 1, q13, q14, q15, q12
    last_column q14, q15, q12, q13
6:  cmn r7, #1
    beq 7f
    vst1.32 {q12}, [r6]!
    b 8f
7:  load_column
    last_column q12, q13, q14
8:  vector_end 1b
    end_function depthwise

@ Adds the second column of a window to \sums and loads the third. q14 is the largest of the first column.
.macro second_column more, pool, sums
    vfma.f32 \sums, q9, q1
    .if \pool
    vmax.f32 q14, q14, q9
    .endif
    .if \more
    vld1.32 {d18-d19}, [r1], r4
    .endif
    vfma.f32 \sums, q10, q4
    .if \pool
    vmax.f32 q14, q14, q10
    .endif
    .if \more
    vld1.32 {d20-d21}, [r2], r4
    .endif
    vfma.f32 \sums, q11, q7
    .if \more
    vld1.32 {d22-d23}, [r3], r4
    .endif
.endm

@ Computes the window of \sums except for its first column, and the first column of \next.
.macro window_of_stride_2 pool, sums, next
    second_column 1, \pool, \sums
    vfma.f32 \sums, q9, q2
    vmul.f32 \next, q9, q0
    .if \pool
    vst1.32 {q14}, [r12], r4
    vmax.f32 q14, q9, q10
    .endif
    vld1.32 {d18-d19}, [r1], r4
    vfma.f32 \sums, q10, q5
    vfma.f32 \next, q10, q3
    vld1.32 {d20-d21}, [r2], r4
    vfma.f32 \sums, q11, q8
    vfma.f32 \next, q11, q6
    vld1.32 {d22-d23}, [r3], r4
    vst1.32 {\sums}, [r6]!
.endm

@ The window at the end of the row, whose third column lies outside the picture.
.macro last_window_of_stride_2 pool, sums
    second_column 0, \pool, \sums
    .if \pool
    vst1.32 {q14}, [r12], r4
    .endif
    vst1.32 {\sums}, [r6]!
.endm

@ r7: pairs of windows, without the last one; r8: 1 if a window is left between those and the last one.
.macro rows_of_stride_2 name, pool
function \name
    depthwise_start
1:  vector_start
    vmul.f32 q12, q9, q0
    .if \pool
    ldr r12, [r0, #40]
    add r12, r12, r10
    vmax.f32 q14, q9, q10
    .endif
    vfma.f32 q12, q10, q3
    vfma.f32 q12, q11, q6
    load_column
    cmp r7, #0
    beq 3f
2:  window_of_stride_2 \pool, q12, q13
    window_of_stride_2 \pool, q13, q12
    subs r7, r7, #1
    bne 2b
3:  cmp r8, #0
    bne 4f
    last_window_of_stride_2 \pool, q12
    b 5f
4:  window_of_stride_2 \pool, q12, q13
    last_window_of_stride_2 \pool, q13
5:  vector_end 1b
    end_function \name
.endm

rows_of_stride_2 depthwise_stride_2, 0
rows_of_stride_2 depthwise_stride_2_largest, 1
