//! The subcommands of `facewire`.

pub mod monitor;
