//! Names the interface that programs are linked with. A change that breaks programs gives it another number.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libfacewire.so.0");
}
