//! An allocator that counts the allocations of each thread and tells them to another process.
//!
//! [`allocation_counter`] measures a closure in the calling thread. Here another process asks about threads that it did not
//! start.
#![allow(unsafe_code, reason = "an allocator is unsafe; this allocator passes every call on")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{Write as _, stdin, stdout};
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering::Relaxed};
use std::thread;

use rustix::thread::gettid;

/// More threads than a service ever has.
const SLOTS: usize = 64;

#[global_allocator]
static COUNTED: Counted = Counted;

static COUNTS: [Slot; SLOTS] = [const { Slot { thread: AtomicI32::new(0), count: AtomicU64::new(0) } }; SLOTS];

struct Slot {
    thread: AtomicI32,
    count: AtomicU64,
}

struct Counted;

// SAFETY: every call goes to the system's allocator unchanged; counting allocates nothing.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(memory, layout, bytes) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Counts an allocation of the calling thread. If short-lived threads have taken all slots, the others share the last slot.
fn count() {
    let thread = gettid().as_raw_nonzero().get();
    let is_own = |slot: &&Slot| {
        let taken = slot.thread.compare_exchange(0, thread, Relaxed, Relaxed);
        taken.is_ok() || taken == Err(thread)
    };
    let slot = COUNTS.iter().find(is_own).unwrap_or(&COUNTS[SLOTS - 1]);
    slot.count.fetch_add(1, Relaxed);
}

/// Answers each line of standard input with one of standard output: `thread:count` for every thread.
pub fn answer_on_standard_output() {
    thread::spawn(|| {
        for _ in stdin().lines() {
            let count = |slot: &Slot| format!("{}:{} ", slot.thread.load(Relaxed), slot.count.load(Relaxed));
            let _ = writeln!(stdout(), "{}", COUNTS.iter().map(count).collect::<String>());
        }
    });
}
