//! The facewire packet, version 1.
#![no_std]
