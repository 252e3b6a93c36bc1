//! A run takes no memory from the heap.

#![allow(unsafe_code, reason = "an allocator that counts")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use facewire_engine::graph::{Graph, Kind, Operator, Port, Shape, Window};
use facewire_engine::{Network, Team, kernels};

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: hands everything to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A first convolution, a block, and both outputs one after the other.
#[expect(clippy::expect_used, reason = "a fault of the test itself")]
fn graph() -> Graph<'static> {
    let picture = Shape { rows: 32, columns: 32, channels: 3 };
    let map = Shape { rows: 16, columns: 16, channels: 20 };
    let joined = Shape { rows: 512, columns: 1, channels: 20 };
    let window = |size, stride, before| Window { size, stride, top: before, left: before };
    let first =
        Kind::Convolution { window: window(3, 2, 0), weights: vec![0.1; 540].into(), bias: vec![0.0; 20].into() };
    let depthwise =
        Kind::Depthwise { window: window(3, 1, 1), weights: vec![0.1; 180].into(), bias: vec![0.0; 20].into() };
    let pointwise =
        Kind::Convolution { window: window(1, 1, 0), weights: vec![0.1; 400].into(), bias: vec![0.0; 20].into() };
    let prelu = Kind::Prelu { slopes: vec![0.5; 20].into() };
    let steps = [
        (first, vec![0], 1),
        (depthwise, vec![1], 2),
        (pointwise, vec![2], 3),
        (Kind::Add, vec![1, 3], 4),
        (prelu, vec![4], 5),
        (Kind::Concatenation, vec![1, 5], 6),
    ];
    let operators = steps.map(|(kind, inputs, output)| Operator { kind, inputs, output }).to_vec();
    let port = |tensor| Port { name: String::new(), tensor };
    let tensors = vec![picture, map, map, map, map, map, joined];
    Graph::new(tensors, operators, port(0), vec![port(5), port(6)]).expect("the network is sound")
}

#[test]
fn a_run_allocates_nothing() {
    let team = Arc::new(Team::new(2).expect("a thread"));
    let both = |kernels| [Network::new(&graph(), kernels), Network::with_team(&graph(), kernels, Arc::clone(&team))];
    for network in kernels::available().into_iter().flat_map(both) {
        let mut network = network.expect("the network consists of layers");
        assert!(ALLOCATIONS.load(Ordering::Relaxed) > 0, "allocations are counted");
        let allocations = [(); 3].map(|()| {
            let before = ALLOCATIONS.load(Ordering::Relaxed);
            network.input_row(31).fill(1.0);
            network.run();
            assert!(network.output(1).iter().all(|value| value.is_finite()));
            ALLOCATIONS.load(Ordering::Relaxed) - before
        });
        // The main thread of the test harness may allocate once meanwhile.
        assert!(allocations.contains(&0), "{allocations:?}");
    }
}
