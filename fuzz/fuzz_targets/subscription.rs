#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| facewire_fuzz::subscription(data));
