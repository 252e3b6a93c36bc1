#!/usr/bin/env python3
"""facewire's own engine against ONNX Runtime, on a face, on altered pictures of it, and on noise.

Usage: check_native.py NATIVE_FOLDER PROGRAM... where PROGRAM is the engine's example `run`, perhaps behind an emulator.
Prints, per network and output, the mean and the largest difference in parts of the output's range.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import onnxruntime

import check
import convert

MEAN_TOLERANCE = 1e-5
WORST_TOLERANCE = 1e-4


def pictures() -> np.ndarray:
    """The face as it is, mirrored, darker, shifted, upside down; NCHW."""
    face = np.load(check.FACE)["picture"].astype(np.float32).transpose(2, 0, 1)[None] / 255
    shifted = np.roll(face, (9, -13), (2, 3))
    return np.concatenate([face, face[..., ::-1], face * 0.4, shifted, face[:, :, ::-1]])


def inputs(sessions: dict[str, onnxruntime.InferenceSession]) -> dict[str, np.ndarray]:
    """Several inputs of each network."""
    mesh = pictures()
    small = (np.arange(128) * 1.5).astype(int)
    all_inputs = {"mesh": mesh, "detector": mesh[:, :, small][..., small] * 2 - 1}
    features = np.concatenate([sessions["mesh"].run(["features"], {"image": p[None]})[0] for p in mesh])
    for name, (row, column) in check.CROPS.items():
        all_inputs[name] = features[:, :, row:row + 16, column:column + 16]
    noise = np.random.default_rng(52)
    return {name: np.concatenate([real, noise.uniform(real.min(), real.max(), real[:2].shape)]).astype(np.float32)
            for name, real in all_inputs.items()}


def native(network: Path, program: list[str], tensors: np.ndarray, sizes: list[int]) -> list[np.ndarray]:
    """Outputs of facewire's engine, one array per output."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in", Path(folder) / "out"
        source.write_bytes(np.ascontiguousarray(tensors.transpose(0, 2, 3, 1)).astype("<f4").tobytes())
        subprocess.run([*program, network, source, target], check=True)
        values = np.fromfile(target, "<f4").reshape(len(tensors), sum(sizes))
    return np.split(values, np.cumsum(sizes)[:-1], axis=1)


def main() -> None:
    """Ends with status 1 if a network differs by more than the tolerances."""
    folder, program = Path(sys.argv[1]), sys.argv[2:]
    onnx = convert.networks_folder()
    sessions = {name: onnxruntime.InferenceSession(str(onnx / f"{name}.onnx")) for name in convert.NETWORKS}
    failed = False
    for name, tensors in inputs(sessions).items():
        session = sessions[name]
        [start] = session.get_inputs()
        runs = [session.run(None, {start.name: tensor[None]}) for tensor in tensors]
        outputs = [np.concatenate(values) for values in zip(*runs)]
        outputs = [v.transpose(0, 2, 3, 1) if v.ndim == 4 else v for v in outputs]
        sizes = [v[0].size for v in outputs]
        found = native(folder / f"{name}.fwnet", program, tensors, sizes)
        for end, expected, values in zip(session.get_outputs(), outputs, found):
            range_ = np.abs(expected).max()
            difference = np.abs(values.reshape(expected.shape) - expected) / range_
            mean, worst = difference.mean(), difference.max()
            print(f"{name:10} {end.name:10} mean {mean:.1e} worst {worst:.1e} of {range_:.4g}")
            failed |= not (mean <= MEAN_TOLERANCE and worst <= WORST_TOLERANCE)
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
