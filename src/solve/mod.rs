//! From landmarks to blendshape coefficients: pure arithmetic, no clock, no I/O, no log.
