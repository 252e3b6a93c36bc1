//! The C interface.
#![no_main]

#[path = "../src/c_interface.rs"]
mod c_interface;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    c_interface::c_interface(bytes);
});
