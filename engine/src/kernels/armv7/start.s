@ Kernels for 32-bit ARM with NEON: 16 registers (q) of 4 values, each made of two halves (d). Only the first 16 halves
@ can be the factor of a multiplication by one value. Functions take a pointer to the structure of the same name in
@ mod.rs. vld1 and vst1 need no alignment beyond that of an f32.
@
@ Loads stand several instructions before their first use, because the small cores run instructions in order.

    .text
    .syntax unified
    .arm
    .fpu neon

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

@ Multiplies one value of each of two or four pixels by the eight weights in \low and \high, and adds the products.
.macro products_of_2 first, low, high, value_0, value_1
    .if \first == 0
    vmla.f32 q8, \low, \value_0
    vmla.f32 q9, \high, \value_0
    vmla.f32 q10, \low, \value_1
    vmla.f32 q11, \high, \value_1
    .else
    vmla.f32 q12, \low, \value_0
    vmla.f32 q13, \high, \value_0
    vmla.f32 q14, \low, \value_1
    vmla.f32 q15, \high, \value_1
    .endif
.endm

.macro products_of_4 low, high, value_0, value_1, value_2, value_3
    products_of_2 0, \low, \high, \value_0, \value_1
    products_of_2 2, \low, \high, \value_2, \value_3
.endm

@ Applies an activation to the sums of one pixel, or of four. An activation is two macros, each of which takes a sum, its
@ slopes (q4, q5) and a register for an intermediate result.
.macro each_sum pixels, begin, end
    \begin q8, q4, q0
    \begin q9, q5, q1
    .if \pixels == 4
    \begin q10, q4, q2
    \begin q11, q5, q3
    .endif
    \end q8, q4, q0
    \end q9, q5, q1
    .if \pixels == 4
    \end q10, q4, q2
    \end q11, q5, q3
    \begin q12, q4, q0
    \begin q13, q5, q1
    \begin q14, q4, q2
    \begin q15, q5, q3
    \end q12, q4, q0
    \end q13, q5, q1
    \end q14, q4, q2
    \end q15, q5, q3
    .endif
.endm

.macro relu sum, zeros, free
    vmax.f32 \sum, \sum, \zeros
.endm

.macro nothing sum, slopes, free
.endm

.macro gentle_prelu_begin sum, slopes, product
    vmul.f32 \product, \sum, \slopes
.endm

.macro gentle_prelu_end sum, slopes, product
    vmax.f32 \sum, \sum, \product
.endm

@ q6 holds zeros.
.macro any_prelu_begin sum, slopes, negative
    vmin.f32 \negative, \sum, q6
    vmax.f32 \sum, \sum, q6
.endm

.macro any_prelu_end sum, slopes, negative
    vmla.f32 \sum, \negative, \slopes
.endm

@ Applies the activation r12 (0 none, 1 ReLU, 2 PReLU with slopes of at most 1, 3 any PReLU) to the sums of \pixels
@ pixels, and stores them at r7, pixels r10 bytes apart. [r0, #12] points at the slopes.
.macro finish pixels
    cmp r12, #2
    blo .Lno_slopes\@
    ldr r4, [r0, #12]
    vld1.32 {d8-d11}, [r4]
    bhi .Lany\@
    each_sum \pixels, gentle_prelu_begin, gentle_prelu_end
    b .Lstore\@
.Lany\@:
    vmov.i32 q6, #0
    each_sum \pixels, any_prelu_begin, any_prelu_end
    b .Lstore\@
.Lno_slopes\@:
    cmp r12, #1
    blo .Lstore\@
    vmov.i32 q4, #0
    vmov.i32 q5, #0
    each_sum \pixels, relu, nothing
.Lstore\@:
    vst1.32 {d16-d19}, [r7], r10
    .if \pixels == 4
    vst1.32 {d20-d23}, [r7], r10
    vst1.32 {d24-d27}, [r7], r10
    vst1.32 {d28-d31}, [r7], r10
    .endif
.endm
