#!/usr/bin/env python3
"""Times facewire's own engine and ONNX Runtime in alternation, on one core and one thread.

Usage: bench_native.py NATIVE_FOLDER TIME where TIME is the engine's example `time`. Both sides run 100 rounds of all
networks in each of 10 turns; the figures are the median turn and the range of turns, in milliseconds.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from pathlib import Path

import convert
from bench import Timed

TURNS, ROUNDS = 10, 100


def main() -> None:
    """Prints one line per network, and one for the four that a followed face needs."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    folder, program = sys.argv[1:3]
    kernels = sys.argv[3] if len(sys.argv) > 3 else "avx512"
    sessions = {name: Timed(Path(convert.networks_folder()) / f"{name}.onnx") for name in convert.NETWORKS}
    native = {name: [] for name in sessions}
    onnx = {name: [] for name in sessions}
    for _ in range(TURNS):
        for session in sessions.values():
            session.seconds.clear()
        for _ in range(ROUNDS):
            for session in sessions.values():
                session.run()
        for name, session in sessions.items():
            onnx[name].append(session.median_ms())
        printed = subprocess.run([program, folder, kernels, str(ROUNDS)], check=True, capture_output=True, text=True)
        for line in printed.stdout.splitlines():
            words = line.split()
            if words[0] in native:
                native[words[0]].append(float(words[1]))
    for times in (native, onnx):
        times["frame"] = [sum(turn) for turn in zip(*(v for k, v in times.items() if k != "detector"))]
    print("network     native (range)            ONNX Runtime (range)      ratio (range)")
    for name in native:
        ratios = [a / b for a, b in zip(native[name], onnx[name])]
        print(f"{name:12}" + "".join(
            f"{statistics.median(v):7.3f} ({min(v):.3f} to {max(v):.3f}) " for v in (native[name], onnx[name], ratios)))


if __name__ == "__main__":
    main()
