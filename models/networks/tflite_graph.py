"""Reads TFLite files as a list of operators, and cuts a part out of a network."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Any

import tflite

# The format characters of the module `struct` for the types of constants.
FORMATS = {tflite.TensorType.FLOAT16: "e", tflite.TensorType.FLOAT32: "f", tflite.TensorType.INT32: "i"}
SAME_PADDING = tflite.Padding.SAME
ACTIVATION_NONE = tflite.ActivationFunctionType.NONE


@dataclass(frozen=True)
class Constant:
    """An array of the file: its shape, the format character of its elements, and its bytes."""

    shape: tuple[int, ...]
    format: str
    data: bytes

    def values(self) -> list[float]:
        """The elements in the order of the file."""
        return list(struct.unpack(f"<{len(self.data) // struct.calcsize(self.format)}{self.format}", self.data))


class Options:
    """The options of an operator as attributes, with the names that the schema of TFLite gives them."""

    def __init__(self, table: Any) -> None:
        self.table = table

    def __getattr__(self, name: str) -> Any:
        return getattr(self.table, name[0].upper() + name[1:])()


@dataclass(frozen=True)
class Operator:
    """An operator, the numbers of its tensors, and its options."""

    kind: str
    inputs: list[int]
    outputs: list[int]
    options: Options | None
    custom_options: bytes


@dataclass(frozen=True)
class Graph:
    """A network. Constants that DEQUANTIZE makes from float16 stay in float16."""

    operators: list[Operator]
    names: dict[int, str]
    shapes: dict[int, tuple[int, ...]]
    constants: dict[int, Constant]
    inputs: list[int]
    outputs: list[int]

    def window_padding(self, op: Operator, kernel: list[int], strides: list[int]) -> list[int]:
        """The padding of a convolution or pooling: top, left, bottom, right. TFLite's SAME adds an odd
        row or column at the end."""
        if op.options.padding != SAME_PADDING:
            return [0, 0, 0, 0]
        size = self.shapes[op.inputs[0]][1:3]
        total = [max((-(-n // s) - 1) * s + k - n, 0) for n, k, s in zip(size, kernel, strides)]
        before = [n // 2 for n in total]
        return before + [n - b for n, b in zip(total, before)]

    def pad(self, op: Operator) -> tuple[list[int], int]:
        """What a PAD adds: the padding of rows and columns (top, left, bottom, right), or a number of
        channels behind the last one."""
        batch_0, batch_1, top, bottom, left, right, first, last = self.constants[op.inputs[1]].values()
        if batch_0 or batch_1 or first or (last and (top or bottom or left or right)):
            raise ValueError("padding of anything but the last channels, or rows and columns")
        return [top, left, bottom, right], last

    def tensor_named(self, name: str) -> int:
        """The number of the tensor called `name`."""
        return next(index for index, found in self.names.items() if found == name)

    def producer(self, tensor: int) -> Operator:
        """The operator that writes a tensor."""
        return next(operator for operator in self.operators if tensor in operator.outputs)

    def cut(self, inputs: list[int], outputs: list[int]) -> Graph:
        """The part of the network between two sets of tensors."""
        wanted, kept = set(outputs), []
        for operator in reversed(self.operators):
            if wanted.intersection(operator.outputs):
                kept.append(operator)
                wanted.update(set(operator.inputs) - set(inputs))
        return replace(self, operators=kept[::-1], inputs=inputs, outputs=outputs)


def read(content: bytes) -> Graph:
    """Reads a TFLite file."""
    model = tflite.Model.GetRootAs(content)
    subgraph = model.Subgraphs(0)
    tensors = [subgraph.Tensors(index) for index in range(subgraph.TensorsLength())]
    data = {index: _data(content, model.Buffers(tensor.Buffer())) for index, tensor in enumerate(tensors)}
    shapes = {index: tuple(_list(tensor.Shape, tensor.ShapeLength())) for index, tensor in enumerate(tensors)}
    constants = {index: Constant(shapes[index], FORMATS[tensors[index].Type()], value)
                 for index, value in data.items() if value}
    operators = []
    for operator in (_operator(model, subgraph.Operators(n)) for n in range(subgraph.OperatorsLength())):
        if operator.kind == "DEQUANTIZE":
            constants[operator.outputs[0]] = constants[operator.inputs[0]]
        else:
            operators.append(operator)
    names = {index: tensor.Name().decode() for index, tensor in enumerate(tensors)}
    inputs = _list(subgraph.Inputs, subgraph.InputsLength())
    outputs = _list(subgraph.Outputs, subgraph.OutputsLength())
    return Graph(operators, names, shapes, constants, inputs, outputs)


def _operator(model: tflite.Model, operator: tflite.Operator) -> Operator:
    code = model.OperatorCodes(operator.OpcodeIndex())
    # A file written before 2020 has the number in DeprecatedBuiltinCode only.
    number = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
    kind = code.CustomCode().decode() if number == tflite.BuiltinOperator.CUSTOM else tflite.opcode2name(number)
    custom = bytes(_list(operator.CustomOptions, operator.CustomOptionsLength()))
    inputs = _list(operator.Inputs, operator.InputsLength())
    outputs = _list(operator.Outputs, operator.OutputsLength())
    return Operator(kind, inputs, outputs, _options(operator), custom)


def _options(operator: tflite.Operator) -> Options | None:
    kinds = {number: name for name, number in vars(tflite.BuiltinOptions).items() if not name.startswith("_")}
    union, name = operator.BuiltinOptions(), kinds[operator.BuiltinOptionsType()]
    if union is None:
        return None
    table = getattr(tflite, name)()
    table.Init(union.Bytes, union.Pos)
    return Options(table)


def _list(element: Any, length: int) -> list[Any]:
    return [element(index) for index in range(length)]


def _data(content: bytes, buffer: tflite.Buffer) -> bytes:
    """The bytes of a buffer, which its own accessor would return one by one."""
    vector = buffer._tab.Offset(4)  # pylint: disable=protected-access
    if vector == 0:
        return b""
    start = buffer._tab.Vector(vector)  # pylint: disable=protected-access
    return content[start:start + buffer.DataLength()]
