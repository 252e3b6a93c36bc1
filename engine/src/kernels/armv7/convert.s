@ Pixels from luma and chroma, sixteen at a time. r0 points at `Conversion` in convert.rs.
@
@ r1 luma, r2 and r3 chroma, r4 output, r5 groups left. q12 luma's factor, q13 black, q14 factors of Cb in blue and Cr in
@ red, q15 those of Cb and Cr in green, q11 chroma without colour.

@ Converts eight pixels: their luma is in \luma, Cb and Cr of every two of them in \chroma. The upper halves of doubled
@ products are products divided by 4 * 8192.
.macro convert_half luma, chroma
    vshll.u8 q8, \luma, #2
    vshll.u8 q9, \chroma, #2
    vsub.i16 q8, q8, q13
    vsub.i16 q9, q9, q11
    vqdmulh.s16 q8, q8, q12
    vqdmulh.s16 q1, q9, q15
    vqdmulh.s16 q2, q9, q14
    vrev32.16 q9, q1
    vmov q0, q2
    vadd.i16 q1, q1, q9
    vtrn.16 q2, q0
    vmov.i16 q3, #0
    vadd.i16 q1, q1, q8
    vadd.i16 q2, q2, q8
    vadd.i16 q0, q0, q8
    vst4.16 {d0, d2, d4, d6}, [r4]!
    vst4.16 {d1, d3, d5, d7}, [r4]!
.endm

.macro conversion name, load
    function convert_\name
    ldm r0!, {r1-r5}
    vld1.16 {d24[], d25[]}, [r0]!
    vld1.16 {d26[], d27[]}, [r0]!
    vld1.32 {d28[], d29[]}, [r0]!
    vld1.32 {d30[], d31[]}, [r0]!
    vmov.i16 q11, #512
    vmov.i8 q5, #128
    cmp r5, #0
    beq 2f
1:  \load
    convert_half d8, d10
    convert_half d9, d11
    subs r5, r5, #1
    bne 1b
2:  end_function convert_\name
.endm

.macro load_yuyv
    vld2.8 {d8-d11}, [r1]!
.endm

.macro load_semi_planar
    vld1.8 {d8-d9}, [r1]!
    vld1.8 {d10-d11}, [r2]!
.endm

.macro load_planar
    vld1.8 {d8-d9}, [r1]!
    vld1.8 {d10}, [r2]!
    vld1.8 {d11}, [r3]!
    vzip.8 d10, d11
.endm

.macro load_grey
    vld1.8 {d8-d9}, [r1]!
.endm

    conversion yuyv, load_yuyv
    conversion semi_planar, load_semi_planar
    conversion planar, load_planar
    conversion grey, load_grey
