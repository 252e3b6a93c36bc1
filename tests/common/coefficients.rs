//! The CSV of `facewire track`.
