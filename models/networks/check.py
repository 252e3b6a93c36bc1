#!/usr/bin/env python3
"""Compares every network that was converted to ONNX with the TFLite interpreter, on noise and on
a face. The interpreter runs the part of the TFLite file from which the network was converted.

Run as a program with a folder as its argument, it writes the inputs and the outputs of the
interpreter into that folder, so that tests/networks.rs can compare facewire's engines with them.
The files NAME-input.f32 and NAME-OUTPUT.f32 hold little-endian float32 values of one case after
the other, each in the order rows, columns, channels.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import flatbuffers
import numpy as np
import onnxruntime
from ai_edge_litert import schema_py_generated as schema
from ai_edge_litert.interpreter import Interpreter, OpResolverType

import convert
from networks import Network
from sources import SetupError

# Largest difference allowed, as a share of the largest value of an output: 0.003 px on the
# mesh. Two float32 libraries that add in different orders differ by less than a tenth of it.
TOLERANCE = 2e-5

# The face in a frame of the built-in clip: array "picture", 192 x 192 RGB.
FACE = Path(__file__).parent / "face.npz"

# First row and column of the 16 x 16 crops around the lips and the eyes in the feature map of that picture.
CROPS = {"lips": (24, 16), "left_eye": (11, 10), "right_eye": (11, 22)}


class Reference:
    """The TFLite interpreter, with pictures and feature maps in NCHW order."""

    def __init__(self, network: Network) -> None:
        # Without a delegate the interpreter uses TensorFlow's own kernels.
        self.interpreter = Interpreter(
            model_content=_cut_file(network),
            experimental_op_resolver_type=OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES,
        )
        self.interpreter.allocate_tensors()

    def run(self, tensor: np.ndarray) -> list[np.ndarray]:
        """The outputs for an input, both in NCHW order."""
        [start] = self.interpreter.get_input_details()
        self.interpreter.set_tensor(start["index"], tensor.transpose(0, 2, 3, 1))
        self.interpreter.invoke()
        ends = self.interpreter.get_output_details()
        values = [self.interpreter.get_tensor(end["index"]) for end in ends]
        return [v.transpose(0, 3, 1, 2) if v.ndim == 4 else v for v in values]


def check(networks: list[Network], folder: Path) -> None:
    """Raises SetupError if a network in `folder` differs from its reference."""
    for network, inputs in cases(networks):
        worst = max(_difference(network, folder, tensor) for tensor in inputs)
        print(f"networks: {network.name} agrees with TFLite to {worst:.1e} of its range")


def write_reference(networks: list[Network], folder: Path) -> None:
    """Writes inputs of every network and the outputs of the interpreter."""
    for network, inputs in cases(networks):
        interpreter = Reference(network)
        outputs = zip(*(interpreter.run(tensor) for tensor in inputs))
        for name, values in [("input", inputs), *zip(network.outputs, outputs)]:
            stored = [v.transpose(0, 2, 3, 1) if v.ndim == 4 else v for v in values]
            (folder / f"{network.name}-{name}.f32").write_bytes(np.concatenate(stored).astype("<f4").tobytes())


def cases(networks: list[Network]) -> Iterator[tuple[Network, list[np.ndarray]]]:
    """Yields each network with two inputs: noise, and the input that results from the picture of a face."""
    noise = np.random.default_rng(52)
    realistic = _inputs_of_a_face(next(n for n in networks if n.name == "mesh"))
    for network in networks:
        face = realistic[network.name]
        yield network, [noise.uniform(face.min(), face.max(), face.shape).astype(np.float32), face]


def _difference(network: Network, folder: Path, tensor: np.ndarray) -> float:
    session = onnxruntime.InferenceSession(
        str(folder / f"{network.name}.onnx"), providers=["CPUExecutionProvider"]
    )
    found = session.run(list(network.outputs), {network.input: tensor})
    expected = Reference(network).run(tensor)
    worst = 0.0
    for name, value, reference in zip(network.outputs, found, expected):
        range_ = float(np.abs(reference).max())
        difference = float(np.abs(value - reference.reshape(value.shape)).max()) / range_
        if not difference <= TOLERANCE:
            raise SetupError(
                f"{network.name}: {name} differs from the TFLite interpreter by {difference:.1e} of its range, "
                f"allowed are {TOLERANCE:.0e}: the conversion is wrong, please report it"
            )
        worst = max(worst, difference)
    return worst


def _inputs_of_a_face(mesh: Network) -> dict[str, np.ndarray]:
    """The inputs of all networks, computed from the picture of a face."""
    pixels = np.load(FACE)["picture"].astype(np.float32).transpose(2, 0, 1)[None] / 255
    _, flag, features = Reference(mesh).run(pixels)
    if flag.item() <= 0:
        raise SetupError(f"the landmark network finds no face in {FACE}")
    small = (np.arange(128) * 1.5).astype(int)
    inputs = {"mesh": pixels, "detector": pixels[:, :, small][..., small] * 2 - 1}
    for name, (row, column) in CROPS.items():
        inputs[name] = features[:, :, row:row + 16, column:column + 16]
    return {name: np.ascontiguousarray(tensor) for name, tensor in inputs.items()}


def _cut_file(network: Network) -> bytes:
    """Returns a TFLite file that contains only this network."""
    model = schema.ModelT.InitFromObj(schema.Model.GetRootAsModel(network.file, 0))
    subgraph = model.subgraphs[0]
    wanted = set(network.graph.outputs)
    kept = []
    for operator in reversed(subgraph.operators):
        if wanted.intersection(operator.outputs):
            kept.append(operator)
            wanted.update(set(operator.inputs) - set(network.graph.inputs))
    subgraph.operators = kept[::-1]
    subgraph.inputs, subgraph.outputs = network.graph.inputs, network.graph.outputs
    model.signatureDefs = []
    _drop_unused_codes(model)
    builder = flatbuffers.Builder(1 << 20)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def _drop_unused_codes(model: schema.ModelT) -> None:
    """Removes unused operators from the file's list: the interpreter refuses a file whose list
    contains a custom operator that it does not know, even if nothing uses it."""
    operators = model.subgraphs[0].operators
    used = sorted({operator.opcodeIndex for operator in operators})
    model.operatorCodes = [model.operatorCodes[index] for index in used]
    for operator in operators:
        operator.opcodeIndex = used.index(operator.opcodeIndex)


def main() -> None:
    """Writes the reference into the folder that the command line names."""
    parser = argparse.ArgumentParser(
        description="Writes inputs of each network and the outputs of the TFLite interpreter for them."
    )
    parser.add_argument("folder", type=Path, help="an existing folder for the files NAME-input.f32 and NAME-OUTPUT.f32")
    write_reference(convert.cut_networks(), parser.parse_args().folder)


if __name__ == "__main__":
    main()
