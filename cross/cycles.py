"""Estimates the cycles that a frame takes on three cores from the instructions counted and from simulated caches.

This is an estimate that no measurement on a board has confirmed. For each function, a core needs at least the cycles of its
busiest part: instructions by issue width, vector arithmetic, loads, and stores. An in-order core cannot load while it
multiplies, so the cycles of both are added. The lower figure of an estimate is the sum of these bounds, as if a
prefetcher hid every cache miss. The upper figure adds the latency of every miss in the simulated caches, as if nothing hid any.

Widths and rates of Cortex-A72 and A76 come from Arm's software optimization guides (UAN 0016A; PJDOC-466751330-7215).
Arm publishes none for Cortex-A53. Its rates here are those that authors of kernels have measured: one 128-bit multiply-add
per cycle, 64 bits loaded per cycle, and 128 bits stored per cycle. Cache sizes are those of the boards. The latencies
are typical of these boards, rounded.
"""

import dataclasses
import sys


@dataclasses.dataclass(frozen=True)
class Core:
    """A core on a board. All rates are per cycle."""

    name: str
    board: str
    clock_ghz: float
    in_order: bool
    # Rates of all instructions, 128-bit vector instructions, loads, 64-bit words loaded, and stores.
    issues: float
    vectors: float
    loads: float
    words: float
    stores: float
    # KiB and ways of the first and second cache, for the simulation.
    caches: str
    # Latency of the second cache in cycles, and of memory in nanoseconds.
    l2_cycles: float
    memory_ns: float


CORES = (
    Core("cortex-a53", "Pi Zero 2 W", 1.0, True, 2, 1, 1, 1, 1, "32:4:512:16", 15, 150),
    Core("cortex-a72", "Pi 4", 1.5, False, 3, 1, 1, 2, 1, "32:2:1024:16", 20, 150),
    Core("cortex-a76", "Pi 5", 2.4, False, 4, 2, 2, 4, 2, "64:4:512:8", 10, 120),
)


def bound(core, counts):
    """Returns the fewest cycles that a core can take for the instructions of a function."""
    vectors = (counts["multiply_adds"] + counts["other_vector"]) / core.vectors
    loads = max(counts["loads"] / core.loads, counts["words_loaded"] / core.words)
    arithmetic = (vectors + loads,) if core.in_order else (vectors, loads)
    return max(counts["all"] / core.issues, counts["stores"] / core.stores, *arithmetic)


def misses(core, counts):
    """Returns the cycles that the cache misses of a function take if nothing hides them."""
    return counts["l1_misses"] * core.l2_cycles + counts["l2_misses"] * core.memory_ns * core.clock_ghz


def estimate(core, functions):
    """Returns the fewest and the most cycles of a frame."""
    fewest = sum(bound(core, counts) for counts in functions.values())
    return fewest, fewest + sum(misses(core, counts) for counts in functions.values())


if __name__ == "__main__" and sys.argv[1:] == ["--caches"]:
    print(*(f"{core.name}={core.caches}" for core in CORES))
