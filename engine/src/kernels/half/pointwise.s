// A pointwise convolution in half precision to 16 output channels. The structure that x0 points at is `Panel` in mod.rs.
//
// Sums of up to eight pixels over a group of 16 input channels: v16 to v31, two registers of eight sums for each pixel; values
// of four channels: v0 to v3, two pixels in each register; weights: v4 to v7. The sums over all channels are in single
// precision on the stack, 16 for each pixel, and begin with bias and residual. After each group its sums are widened and
// added to these. Longer sums in half precision would lose small products to rounding.
//
// x1 operand, x2 weights, x3 operand of a channel, x5 groups left besides the last, x6 residual, x7 output, x8 pixels left,
// x9 and x10 bytes between pixels of residual and output, x11 bytes between vectors of channels of the operand,
// x12 is x11 - 32, x13 bias, x14 slopes, x15 first weights, x16 whether a slope is above 1, x17 sums of a pixel on the stack.

    .text
    .arch_extension fp16

// Multiplies one channel of \pixels pixels by the weights in \low and \high.
.macro products operation, pixels, low, high, channel
    \operation v16.8h, \low\().8h, v0.h[\channel]
    \operation v17.8h, \high\().8h, v0.h[\channel]
    .if \pixels > 1
    \operation v18.8h, \low\().8h, v0.h[\channel + 4]
    \operation v19.8h, \high\().8h, v0.h[\channel + 4]
    \operation v20.8h, \low\().8h, v1.h[\channel]
    \operation v21.8h, \high\().8h, v1.h[\channel]
    \operation v22.8h, \low\().8h, v1.h[\channel + 4]
    \operation v23.8h, \high\().8h, v1.h[\channel + 4]
    .endif
.endm

// The same for the last four of eight pixels.
.macro more_products operation, pixels, low, high, channel
    .if \pixels == 8
    \operation v24.8h, \low\().8h, v2.h[\channel]
    \operation v25.8h, \high\().8h, v2.h[\channel]
    \operation v26.8h, \low\().8h, v2.h[\channel + 4]
    \operation v27.8h, \high\().8h, v2.h[\channel + 4]
    \operation v28.8h, \low\().8h, v3.h[\channel]
    \operation v29.8h, \high\().8h, v3.h[\channel]
    \operation v30.8h, \low\().8h, v3.h[\channel + 4]
    \operation v31.8h, \high\().8h, v3.h[\channel + 4]
    .endif
.endm

// Loads four channels of the first pixels, and of the last four of eight.
.macro load_values pixels
    .if \pixels == 1
    ld1 {v0.4h}, [x3], x11
    .elseif \pixels == 4
    ld1 {v0.8h, v1.8h}, [x3], x11
    .else
    ld1 {v0.8h, v1.8h}, [x3], #32
    .endif
.endm

.macro load_more_values pixels
    .if \pixels == 8
    ld1 {v2.8h, v3.8h}, [x3], x12
    .endif
.endm

// Multiplies four channels, the first of them with \operation, and loads the next four if \more.
.macro four_channels pixels, operation, more
    products \operation, \pixels, v4, v5, 0
    more_products \operation, \pixels, v4, v5, 0
    ldp q4, q5, [x2], #32
    products fmla, \pixels, v6, v7, 1
    more_products fmla, \pixels, v6, v7, 1
    ldp q6, q7, [x2], #32
    products fmla, \pixels, v4, v5, 2
    more_products fmla, \pixels, v4, v5, 2
    .if \more
    ldp q4, q5, [x2], #32
    .endif
    products fmla, \pixels, v6, v7, 3
    .if \more
    load_values \pixels
    .endif
    more_products fmla, \pixels, v6, v7, 3
    .if \more
    load_more_values \pixels
    ldp q6, q7, [x2], #32
    .endif
.endm

// Multiplies a group of channels, and loads the first four channels of the next group if \more.
.macro sixteen_channels pixels, more
    four_channels \pixels, fmul, 1
    four_channels \pixels, fmla, 1
    four_channels \pixels, fmla, 1
    four_channels \pixels, fmla, \more
.endm

// Runs \operation for each of \pixels pixels; its last two arguments are the registers with the sums of the pixel.
.macro each_pixel pixels, operation:vararg
    \operation v16, v17
    .if \pixels > 1
    \operation v18, v19
    \operation v20, v21
    \operation v22, v23
    .endif
    .if \pixels == 8
    \operation v24, v25
    \operation v26, v27
    \operation v28, v29
    \operation v30, v31
    .endif
.endm

// Begins the sums of one pixel with bias (v12 to v15) and residual.
.macro begin_pixel low, high
    ld1 {v8.4s-v11.4s}, [x6], x9
    fadd v8.4s, v8.4s, v12.4s
    fadd v9.4s, v9.4s, v13.4s
    fadd v10.4s, v10.4s, v14.4s
    fadd v11.4s, v11.4s, v15.4s
    st1 {v8.4s-v11.4s}, [x17], #64
.endm

// Adds the sums over a group of channels to those of one pixel, into v8 to v11.
.macro widen low, high
    ld1 {v8.4s-v11.4s}, [x17]
    fcvtl v12.4s, \low\().4h
    fcvtl2 v13.4s, \low\().8h
    fcvtl v14.4s, \high\().4h
    fcvtl2 v15.4s, \high\().8h
    fadd v8.4s, v8.4s, v12.4s
    fadd v9.4s, v9.4s, v13.4s
    fadd v10.4s, v10.4s, v14.4s
    fadd v11.4s, v11.4s, v15.4s
.endm

.macro add_pixel low, high
    widen \low, \high
    st1 {v8.4s-v11.4s}, [x17], #64
.endm

// Multiplies the sums of one pixel that are negative by their slopes (v4 to v7) and stores the results. The slopes are at
// most 1 if \gentle.
.macro finish_pixel gentle, low, high
    widen \low, \high
    add x17, x17, #64
    .if \gentle
    fmul v0.4s, v8.4s, v4.4s
    fmul v1.4s, v9.4s, v5.4s
    fmul v2.4s, v10.4s, v6.4s
    fmul v3.4s, v11.4s, v7.4s
    fmax v0.4s, v0.4s, v8.4s
    fmax v1.4s, v1.4s, v9.4s
    fmax v2.4s, v2.4s, v10.4s
    fmax v3.4s, v3.4s, v11.4s
    .else
    movi v15.4s, #0
    fmax v0.4s, v8.4s, v15.4s
    fmax v1.4s, v9.4s, v15.4s
    fmax v2.4s, v10.4s, v15.4s
    fmax v3.4s, v11.4s, v15.4s
    fmin v8.4s, v8.4s, v15.4s
    fmin v9.4s, v9.4s, v15.4s
    fmin v10.4s, v10.4s, v15.4s
    fmin v11.4s, v11.4s, v15.4s
    fmla v0.4s, v8.4s, v4.4s
    fmla v1.4s, v9.4s, v5.4s
    fmla v2.4s, v10.4s, v6.4s
    fmla v3.4s, v11.4s, v7.4s
    .endif
    st1 {v0.4s-v3.4s}, [x7], x10
.endm

// Computes \pixels pixels at a time while at least that many are left.
.macro tiles pixels
    cmp x8, #\pixels
    b.lo 6f
1:  mov x3, x1
    mov x2, x15
    mov x17, sp
    ldr x5, [x0, #64]
    add x1, x1, #8 * \pixels
    ld1 {v12.4s-v15.4s}, [x13]
    each_pixel \pixels, begin_pixel
    load_values \pixels
    load_more_values \pixels
    ldp q4, q5, [x2], #32
    ldp q6, q7, [x2], #32
    cbz x5, 3f
2:  mov x17, sp
    sixteen_channels \pixels, 1
    each_pixel \pixels, add_pixel
    subs x5, x5, #1
    b.ne 2b
3:  mov x17, sp
    sixteen_channels \pixels, 0
    ld1 {v4.4s-v7.4s}, [x14]
    cbnz x16, 4f
    each_pixel \pixels, finish_pixel 1,
    b 5f
4:  each_pixel \pixels, finish_pixel 0,
5:  sub x8, x8, #\pixels
    cmp x8, #\pixels
    b.hs 1b
6:
.endm

    .globl facewire_engine_half_pointwise
    .hidden facewire_engine_half_pointwise
    .type facewire_engine_half_pointwise, %function
    .p2align 4
facewire_engine_half_pointwise:
    stp d8, d9, [sp, #-64]!
    stp d10, d11, [sp, #16]
    stp d12, d13, [sp, #32]
    stp d14, d15, [sp, #48]
    sub sp, sp, #512
    ldp x1, x15, [x0]
    ldp x13, x14, [x0, #16]
    ldp x16, x6, [x0, #32]
    ldp x7, x8, [x0, #48]
    ldp x11, x9, [x0, #72]
    ldr x10, [x0, #88]
    sub x12, x11, #32
    tiles 8
    tiles 4
    tiles 1
    add sp, sp, #512
    ldp d10, d11, [sp, #16]
    ldp d12, d13, [sp, #32]
    ldp d14, d15, [sp, #48]
    ldp d8, d9, [sp], #64
    ret
    .size facewire_engine_half_pointwise, . - facewire_engine_half_pointwise

// Without these lines, the macros and directives would apply to the assembly of other crates that is compiled with this.
    .arch_extension nofp16
    .purgem products
    .purgem more_products
    .purgem load_values
    .purgem load_more_values
    .purgem four_channels
    .purgem sixteen_channels
    .purgem each_pixel
    .purgem begin_pixel
    .purgem widen
    .purgem add_pixel
    .purgem finish_pixel
    .purgem tiles
