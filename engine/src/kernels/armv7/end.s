
@ Without these lines, the macros and directives would apply to the assembly of other crates that is compiled with this.

    .fpu vfpv3-d16
    .purgem function
    .purgem end_function
    .purgem products_of_2
    .purgem products_of_4
    .purgem each_sum
    .purgem relu
    .purgem nothing
    .purgem gentle_prelu_begin
    .purgem gentle_prelu_end
    .purgem any_prelu_begin
    .purgem any_prelu_end
    .purgem finish
    .purgem four_channels
    .purgem load_column
    .purgem depthwise_start
    .purgem vector_start
    .purgem vector_end
    .purgem column_of_3
    .purgem last_column
    .purgem second_column
    .purgem window_of_stride_2
    .purgem last_window_of_stride_2
    .purgem rows_of_stride_2
    .purgem four_values
    .purgem products_of_value
    .purgem convert_half
    .purgem conversion
    .purgem load_yuyv
    .purgem load_semi_planar
    .purgem load_planar
    .purgem load_grey
