//! The workbench: fits and judges the blendshape models.
fn main() {}
