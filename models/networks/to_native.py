"""Writes the networks in the form that facewire's own engine reads: engine/src/file.rs describes it.

Operators keep TFLite's order of elements (rows, columns, channels). PAD of rows and columns
becomes the padding of the convolution that follows. RESHAPE is left out, because it does not
change the order of the elements. Weights keep the precision that they have in the TFLite files:
most are float16.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

from networks import Network
from tflite_graph import ACTIVATION_NONE, Constant, Graph, Operator

MAGIC = b"fwnet\0\0\0"
VERSION = 2
CONVOLUTION, DEPTHWISE, PRELU, RELU, ADD, MAX_POOL, PAD_CHANNELS, CONCATENATION = range(8)
FLOAT16, FLOAT32 = 1, 2
# Operators whose options can name an activation function.
FUSED = ("ADD", "CONCATENATION", "CONV_2D", "DEPTHWISE_CONV_2D", "MAX_POOL_2D")


def write(parts: list[Network], folder: Path) -> None:
    """Writes every network as NAME.fwnet."""
    for part in parts:
        content = Writer(part.graph).content(part.input, part.outputs)
        (folder / f"{part.name}.fwnet").write_bytes(content)


class Writer:
    """Collects the operators and tensors of one network."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.numbers: dict[int, int] = {}
        self.tensors: list[bytes] = []
        self.operators: list[bytes] = []
        self.row_and_column_padding: dict[int, tuple[int, list[int]]] = {}
        self.writers: dict[str, Callable[[Operator], None]] = {
            "ADD": lambda op: self._operator(op, ADD, op.inputs),
            "CONCATENATION": self._concatenation,
            "CONV_2D": self._convolution,
            "DEPTHWISE_CONV_2D": self._convolution,
            "MAX_POOL_2D": self._max_pool,
            "PAD": self._pad,
            "PRELU": self._prelu,
            "RELU": lambda op: self._operator(op, RELU, op.inputs),
            "RESHAPE": self._reshape,
        }

    def content(self, source: str, outputs: dict[str, list[int]]) -> bytes:
        """Converts all operators and returns the content of the file."""
        ends = [_named(source, self._tensor(self.graph.inputs[0]))]
        for operator in self.graph.operators:
            if operator.kind not in self.writers:
                raise ValueError(f"no native form of operator {operator.kind}")
            self.writers[operator.kind](operator)
        for tensor, name in zip(self.graph.outputs, outputs):
            ends.append(_named(name, self._tensor(tensor)))
        counts = struct.pack("<HHH", len(self.tensors), len(self.operators), len(outputs))
        body = b"".join([counts, *self.tensors, *ends, *self.operators])
        return MAGIC + struct.pack("<II", VERSION, zlib.crc32(body)) + body

    def _tensor(self, index: int) -> int:
        """Returns the number of a tensor in the file. Adds the tensor if the file does not have it yet."""
        if index not in self.numbers:
            self.numbers[index] = len(self.tensors)
            self.tensors.append(struct.pack("<3H", *_rows_columns_channels(self.graph.shapes[index])))
        return self.numbers[index]

    def _operator(self, op: Operator, kind: int, inputs: list[int], kernel: int = 1, stride: int = 1,
                  before: tuple[int, int] = (0, 0), arrays: tuple[Constant, ...] = ()) -> None:
        if op.kind in FUSED and op.options.fusedActivationFunction != ACTIVATION_NONE:
            raise ValueError(f"{op.kind} with a fused activation")
        numbers = [self._tensor(index) for index in inputs]
        head = struct.pack("<6B", kind, kernel, stride, *before, len(numbers))
        tensors = struct.pack(f"<{len(numbers) + 1}H", *numbers, self._tensor(op.outputs[0]))
        self.operators.append(b"".join([head, tensors, *map(_array, arrays)]))

    def _convolution(self, op: Operator) -> None:
        """Weights: (out, rows, columns, in), or (1, rows, columns, channels) if depthwise."""
        source, outer = self.row_and_column_padding.get(op.inputs[0], (op.inputs[0], [0, 0, 0, 0]))
        weights, bias = self.graph.constants[op.inputs[1]], self.graph.constants[op.inputs[2]]
        depthwise = op.kind == "DEPTHWISE_CONV_2D"
        if depthwise and op.options.depthMultiplier != 1:
            raise ValueError("depthwise convolution with a multiplier")
        if op.options.dilationHFactor != 1 or op.options.dilationWFactor != 1:
            raise ValueError("dilated convolution")
        kernel, stride = weights.shape[1], op.options.strideH
        if weights.shape[2] != kernel or op.options.strideW != stride:
            raise ValueError("convolution that is not square")
        inner = self.graph.window_padding(op, [kernel] * 2, [stride] * 2)
        before = (outer[0] + inner[0], outer[1] + inner[1])
        kind = DEPTHWISE if depthwise else CONVOLUTION
        self._operator(op, kind, [source], kernel, stride, before, (weights, bias))

    def _max_pool(self, op: Operator) -> None:
        kernel, stride = op.options.filterHeight, op.options.strideH
        if (op.options.filterWidth, op.options.strideW) != (kernel, stride):
            raise ValueError("maximum over a window that is not square")
        top, left, *_ = self.graph.window_padding(op, [kernel] * 2, [stride] * 2)
        self._operator(op, MAX_POOL, op.inputs, kernel, stride, (top, left))

    def _prelu(self, op: Operator) -> None:
        self._operator(op, PRELU, op.inputs[:1], arrays=(self.graph.constants[op.inputs[1]],))

    def _pad(self, op: Operator) -> None:
        source, output = op.inputs[0], op.outputs[0]
        pads, channels = self.graph.pad(op)
        if channels:
            self._operator(op, PAD_CHANNELS, [source])
        else:
            self.row_and_column_padding[output] = (source, pads)

    def _reshape(self, op: Operator) -> None:
        self.numbers[op.outputs[0]] = self._tensor(op.inputs[0])

    def _concatenation(self, op: Operator) -> None:
        if len(self.graph.shapes[op.outputs[0]]) != 3 or op.options.axis != 1:
            raise ValueError("concatenation of feature maps")
        self._operator(op, CONCATENATION, op.inputs)


def _rows_columns_channels(shape: tuple[int, ...]) -> tuple[int, ...]:
    if shape[0] != 1 or len(shape) not in (3, 4):
        raise ValueError(f"no native form of a tensor of shape {shape}")
    return shape[1:] if len(shape) == 4 else (shape[1], 1, shape[2])


def _named(name: str, tensor: int) -> bytes:
    return struct.pack("<HB", tensor, len(name)) + name.encode("ascii")


def _array(constant: Constant) -> bytes:
    if constant.format == "e":
        return struct.pack("<B", FLOAT16) + constant.data
    return struct.pack("<B", FLOAT32) + constant.data
