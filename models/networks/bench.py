#!/usr/bin/env python3
"""Measures how long ONNX Runtime takes for each network in both forms that to_onnx.py writes.

It uses one thread. Each round runs every network once in both forms, so that each network finds
the caches as the one before it left them. The figures are medians of 300 rounds.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import onnxruntime

import convert
import to_onnx

ROUNDS = 300


class Timed:
    """A session with bound input and outputs, the options that facewire sets, and the times of its runs."""

    def __init__(self, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self.session = onnxruntime.InferenceSession(str(path), options)
        self.binding = self.session.io_binding()
        [start] = self.session.get_inputs()
        noise = np.random.default_rng(52).random(start.shape, np.float32)
        self.binding.bind_cpu_input(start.name, noise)
        for end in self.session.get_outputs():
            self.binding.bind_output(end.name)
        self.seconds: list[float] = []

    def run(self) -> None:
        """Runs the network once and records the time."""
        start = time.perf_counter()
        self.session.run_with_iobinding(self.binding)
        self.seconds.append(time.perf_counter() - start)

    def median_ms(self) -> float:
        """Returns the median time of a run, in milliseconds."""
        return statistics.median(self.seconds) * 1e3


def main() -> None:
    """Prints one line for each network."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    parts = convert.cut_networks()
    with tempfile.TemporaryDirectory() as folder:
        timed = {}
        for form in ("blocked", "plain"):
            target = Path(folder) / form
            target.mkdir()
            to_onnx.write(parts, target, blocked=form == "blocked")
            for part in parts:
                timed[form, part.name] = Timed(target / f"{part.name}.onnx")
        for _ in range(ROUNDS):
            for network in timed.values():
                network.run()
    print(f"ONNX Runtime {onnxruntime.__version__}, ms   blocked    plain")
    for part in parts:
        blocked, plain = (timed[form, part.name].median_ms() for form in ("blocked", "plain"))
        print(f"{part.name:28}{blocked:10.3f}{plain:9.3f}")


if __name__ == "__main__":
    main()
