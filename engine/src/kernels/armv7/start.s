@ Kernels for 32-bit ARM with NEON and VFPv4: 16 registers (q) of 4 values, each made of two halves (d). Functions take a
@ pointer to the structure of the same name in the Rust module. vld1 and vst1 need no alignment beyond that of an f32.
@
@ The fused multiply-add takes whole registers only, so the value by which weights are multiplied is loaded into all lanes.
@ Loads stand several instructions before their first use, because the small cores run instructions in order.

    .text
    .syntax unified
    .arm
    .fpu neon-vfpv4

.macro function name
    .globl facewire_engine_neon_\name
    .hidden facewire_engine_neon_\name
    .type facewire_engine_neon_\name, %function
    .p2align 4
facewire_engine_neon_\name:
    push {r4-r11, lr}
    vpush {d8-d15}
.endm

.macro end_function name
    vpop {d8-d15}
    pop {r4-r11, pc}
    .size facewire_engine_neon_\name, . - facewire_engine_neon_\name
.endm

@ The sums of sixteen output channels are in q8 to q11 for the first pixel of a tile, and in q12 to q15 for the second one.
@ The macros below take the number of pixels, 1 or 2.

@ Adds the products of sixteen weights (q4 to q7) and a value of each pixel (q0 and q1, or q2 and q3 if \now is 1). If
@ \more, loads the next weights from r2 and the next values from r3 and r4, which \step takes to the values after those.
.macro products pixels, now, step, more
    .if \now == 0
    products_of \pixels, q0, q1, d4, d5, d6, d7, \step, \more
    .else
    products_of \pixels, q2, q3, d0, d1, d2, d3, \step, \more
    .endif
.endm

.macro products_of pixels, first, second, low_0, high_0, low_1, high_1, step, more
    .if \more
    vld1.32 {\low_0[], \high_0[]}, [r3], \step
    .endif
    vfma.f32 q8, q4, \first
    vfma.f32 q9, q5, \first
    .if \pixels == 2
    .if \more
    vld1.32 {\low_1[], \high_1[]}, [r4], \step
    .endif
    vfma.f32 q12, q4, \second
    vfma.f32 q13, q5, \second
    .endif
    .if \more
    vld1.32 {d8-d11}, [r2]!
    .endif
    vfma.f32 q10, q6, \first
    vfma.f32 q11, q7, \first
    .if \pixels == 2
    vfma.f32 q14, q6, \second
    vfma.f32 q15, q7, \second
    .endif
    .if \more
    vld1.32 {d12-d15}, [r2]!
    .endif
.endm

@ Loads the first weights and values. r11 is 4.
.macro first_products pixels
    vld1.32 {d0[], d1[]}, [r3], r11
    vld1.32 {d8-d11}, [r2]!
    .if \pixels == 2
    vld1.32 {d2[], d3[]}, [r4], r11
    .endif
    vld1.32 {d12-d15}, [r2]!
.endm

@ Starts all sums with the bias at r2.
.macro start_sums pixels
    vld1.32 {d16-d19}, [r2]
    .if \pixels == 2
    vld1.32 {d24-d27}, [r2]
    .endif
    add r2, r2, #32
    vld1.32 {d20-d23}, [r2]
    .if \pixels == 2
    vld1.32 {d28-d31}, [r2]
    .endif
.endm

@ Applies an activation to all sums. An activation is two macros, each of which takes a sum, its slopes and a register for
@ an intermediate result.
.macro each_sum pixels, begin, end
    \begin q8, q4, q0
    \begin q9, q5, q1
    \begin q10, q6, q2
    \end q8, q4, q0
    \begin q11, q7, q0
    \end q9, q5, q1
    \end q10, q6, q2
    .if \pixels == 2
    \begin q12, q4, q1
    \begin q13, q5, q2
    .endif
    \end q11, q7, q0
    .if \pixels == 2
    \begin q14, q6, q0
    \end q12, q4, q1
    \begin q15, q7, q1
    \end q13, q5, q2
    \end q14, q6, q0
    \end q15, q7, q1
    .endif
.endm

@ q3 holds zeros.
.macro relu sum, slopes, free
    vmax.f32 \sum, \sum, q3
.endm

.macro nothing sum, slopes, free
.endm

.macro gentle_prelu_begin sum, slopes, product
    vmul.f32 \product, \sum, \slopes
.endm

.macro gentle_prelu_end sum, slopes, product
    vmax.f32 \sum, \sum, \product
.endm

@ q3 holds zeros.
.macro any_prelu_begin sum, slopes, negative
    vmin.f32 \negative, \sum, q3
    vmax.f32 \sum, \sum, q3
.endm

.macro any_prelu_end sum, slopes, negative
    vfma.f32 \sum, \negative, \slopes
.endm

@ Applies the activation r12 (0 none, 1 ReLU, 2 PReLU with slopes of at most 1, 3 any PReLU), and stores the sums at r7, to
@ which r10 is added after the first half of a pixel. [r0, #12] points at the slopes.
.macro finish pixels
    cmp r12, #1
    blo .Lstore\@
    vmov.i32 q3, #0
    beq .Lrelu\@
    ldr r4, [r0, #12]
    vld1.32 {d8-d11}, [r4]!
    vld1.32 {d12-d15}, [r4]
    cmp r12, #2
    bhi .Lany\@
    each_sum \pixels, gentle_prelu_begin, gentle_prelu_end
    b .Lstore\@
.Lany\@:
    each_sum \pixels, any_prelu_begin, any_prelu_end
    b .Lstore\@
.Lrelu\@:
    each_sum \pixels, relu, nothing
.Lstore\@:
    vst1.32 {d16-d19}, [r7]!
    vst1.32 {d20-d23}, [r7], r10
    .if \pixels == 2
    vst1.32 {d24-d27}, [r7]!
    vst1.32 {d28-d31}, [r7], r10
    .endif
.endm
