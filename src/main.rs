//! The `facewire` command.
fn main() {}
