"""Reads TFLite files as a list of operators, and cuts a part out of a network.

`cut` returns a valid TFLite file, so that the interpreter can run each part as the reference
of its conversion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flatbuffers
import numpy as np
from ai_edge_litert import schema_py_generated as schema

Model = Any  # schema.ModelT, which the generated module does not type

OPERATOR_NAMES = {
    value: name for name, value in vars(schema.BuiltinOperator).items() if not name.startswith("_")
}
DTYPES = {
    schema.TensorType.FLOAT32: np.float32,
    schema.TensorType.FLOAT16: np.float16,
    schema.TensorType.INT32: np.int32,
}


@dataclass
class Operator:
    """An operator, the numbers of its tensors, and its options as the schema has them."""

    kind: str
    inputs: list[int]
    outputs: list[int]
    options: Any


@dataclass
class Graph:
    """A network whose float16 weights have been converted to float32 constants."""

    operators: list[Operator]
    shapes: dict[int, tuple[int, ...]]
    constants: dict[int, np.ndarray]
    inputs: list[int]
    outputs: list[int]

    def window_padding(self, op: Operator, kernel: list[int], strides: list[int]) -> list[int]:
        """The padding of a convolution or pooling: top, left, bottom, right. TFLite's SAME adds an odd
        row or column at the end."""
        if op.options.padding != schema.Padding.SAME:
            return [0, 0, 0, 0]
        size = self.shapes[op.inputs[0]][1:3]
        total = [max((-(-n // s) - 1) * s + k - n, 0) for n, k, s in zip(size, kernel, strides)]
        before = [n // 2 for n in total]
        return before + [n - b for n, b in zip(total, before)]

    def pad(self, op: Operator) -> tuple[list[int], int]:
        """What a PAD adds: the padding of rows and columns (top, left, bottom, right), or a number of
        channels behind the last one."""
        batch, rows, columns, channels = self.constants[op.inputs[1]].tolist()
        if any(batch) or channels[0] or (channels[1] and any(rows + columns)):
            raise ValueError("padding of anything but the last channels, or rows and columns")
        return [rows[0], columns[0], rows[1], columns[1]], channels[1]


def load(content: bytes) -> Model:
    """Parses a TFLite file."""
    return schema.ModelT.InitFromObj(schema.Model.GetRootAsModel(content, 0))


def save(model: Model) -> bytes:
    """Serialises a model as a TFLite file."""
    builder = flatbuffers.Builder(1 << 20)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def kind_of(model: Model, operator: Any) -> str:
    """The operator's name in the schema, or the name of a custom operator."""
    code = model.operatorCodes[operator.opcodeIndex]
    # A file written before 2020 has the number in deprecatedBuiltinCode only.
    name = OPERATOR_NAMES[max(code.builtinCode, code.deprecatedBuiltinCode)]
    return code.customCode.decode() if name == "CUSTOM" else name


def tensor_named(model: Model, name: str) -> int:
    """The number of the tensor called `name`."""
    tensors = model.subgraphs[0].tensors
    return next(index for index, tensor in enumerate(tensors) if tensor.name.decode() == name)


def producer(model: Model, tensor: int) -> Any:
    """The operator that writes a tensor."""
    return next(o for o in model.subgraphs[0].operators if tensor in o.outputs)


def cut(content: bytes, inputs: list[int], outputs: list[int]) -> bytes:
    """Returns the part of a network between two sets of tensors as a TFLite file."""
    model = load(content)
    subgraph = model.subgraphs[0]
    wanted, kept = set(outputs), []
    for operator in reversed(subgraph.operators):
        if wanted.intersection(operator.outputs):
            kept.append(operator)
            wanted.update(set(int(i) for i in operator.inputs) - set(inputs))
    subgraph.operators = kept[::-1]
    subgraph.inputs, subgraph.outputs = inputs, outputs
    model.signatureDefs = []
    _drop_unused_codes(model)
    return save(model)


def _drop_unused_codes(model: Model) -> None:
    """Removes unused operators from the file's list: the interpreter refuses a file whose list
    contains a custom operator that it does not know, even if nothing uses it."""
    operators = model.subgraphs[0].operators
    used = sorted({operator.opcodeIndex for operator in operators})
    model.operatorCodes = [model.operatorCodes[index] for index in used]
    for operator in operators:
        operator.opcodeIndex = used.index(operator.opcodeIndex)


def read(content: bytes) -> Graph:
    """Reads the operators of a file and computes the constants that DEQUANTIZE makes."""
    model = load(content)
    subgraph = model.subgraphs[0]
    constants = {index: array for index in range(len(subgraph.tensors))
                 if (array := _constant(model, index)) is not None}
    operators = []
    for operator in subgraph.operators:
        kind = kind_of(model, operator)
        inputs = [int(index) for index in operator.inputs]
        outputs = [int(index) for index in operator.outputs]
        if kind == "DEQUANTIZE":
            constants[outputs[0]] = constants[inputs[0]].astype(np.float32)
        else:
            operators.append(Operator(kind, inputs, outputs, operator.builtinOptions))
    shapes = {index: tuple(int(n) for n in tensor.shape)
              for index, tensor in enumerate(subgraph.tensors) if tensor.shape is not None}
    ends = [int(i) for i in subgraph.inputs], [int(i) for i in subgraph.outputs]
    return Graph(operators, shapes, constants, *ends)


def _constant(model: Model, index: int) -> np.ndarray | None:
    tensor = model.subgraphs[0].tensors[index]
    data = model.buffers[tensor.buffer].data
    if data is None or len(data) == 0:
        return None
    flat = np.frombuffer(bytes(data), DTYPES[tensor.type])
    return flat.reshape([int(n) for n in tensor.shape])
