"""Converts TFLite operators to ONNX nodes: NHWC to NCHW, fixed shapes, float32.

On x86-64 ONNX Runtime keeps activations in a blocked layout. An operator that it implements
only in the plain layout costs two reorderings of the tensor. For such a machine (`blocked`),
the two operators of these networks that it affects are written as convolutions:

- PReLU, slope a per channel:  x + (1 - a) * relu(-x), both factors as 1x1 depthwise
  convolutions, so that the ReLU and the sum are fused into them;
- PAD of the channels: a 1x1 convolution with an identity matrix.

For other machines they are written as PRelu and Pad. PAD of rows and columns becomes the
padding of the convolution that follows. models/README.md lists the times of both forms.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from networks import Network
from tflite_graph import ACTIVATION_NONE, Constant, Graph, Operator

OPSET = 17
IR_VERSION = 8


def write(networks: list[Network], folder: Path, blocked: bool) -> None:
    """Writes every network as an ONNX file into `folder`."""
    for network in networks:
        converter = Converter(network.graph, blocked)
        model = converter.model(network.name, network.input, network.outputs)
        (folder / f"{network.name}.onnx").write_bytes(model.SerializeToString())


class Converter:
    """Builds one ONNX model. Tensors are named t<number>; those with 4 axes are NCHW."""

    def __init__(self, graph: Graph, blocked: bool) -> None:
        self.graph = graph
        self.blocked = blocked
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: dict[str, onnx.TensorProto] = {}
        self.rows_and_columns_padding: dict[int, tuple[int, list[int]]] = {}
        self.emitters: dict[str, Callable[[Operator], None]] = {
            "ADD": self._add,
            "CONCATENATION": self._concatenation,
            "CONV_2D": self._convolution,
            "DEPTHWISE_CONV_2D": self._convolution,
            "MAX_POOL_2D": self._max_pool,
            "PAD": self._pad,
            "PRELU": self._prelu,
            "RELU": lambda op: self._node("Relu", [self._t(op.inputs[0])], self._t(op.outputs[0])),
            "RESHAPE": self._reshape,
        }

    def model(self, name: str, source: str, outputs: dict[str, list[int]]) -> onnx.ModelProto:
        """Converts all operators. The input and the outputs get the names and shapes given."""
        for operator in self.graph.operators:
            if operator.kind not in self.emitters:
                raise ValueError(f"{name}: no conversion for operator {operator.kind}")
            self.emitters[operator.kind](operator)
        ends = [self._output(t, n, s) for t, (n, s) in zip(self.graph.outputs, outputs.items())]
        start = self._input(self.graph.inputs[0], source)
        graph = helper.make_graph(self.nodes, name, [start], ends, list(self.initializers.values()))
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION,
            producer_name="facewire models/networks",
        )
        onnx.checker.check_model(model, full_check=True)
        return model

    # Names, nodes and shapes.

    @staticmethod
    def _t(index: int) -> str:
        return f"t{index}"

    def _node(self, kind: str, inputs: list[str], output: str, **attributes: object) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def _initializer(self, name: str, array: np.ndarray) -> str:
        self.initializers[name] = numpy_helper.from_array(np.ascontiguousarray(array), name)
        return name

    def _rename(self, old: str, new: str) -> None:
        for node in self.nodes:
            node.input[:] = [new if i == old else i for i in node.input]
            node.output[:] = [new if o == old else o for o in node.output]

    def _input(self, tensor: int, name: str) -> onnx.ValueInfoProto:
        self._rename(self._t(tensor), name)
        shape = nchw(self.graph.shapes[tensor])
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    def _output(self, tensor: int, name: str, shape: list[int]) -> onnx.ValueInfoProto:
        if nchw(self.graph.shapes[tensor]) == shape:
            self._rename(self._t(tensor), name)
        elif self.graph.shapes[tensor][:3] != (1, 1, 1):
            raise ValueError(f"{name}: a reshape would change the order of the elements")
        else:
            dims = self._initializer(f"{name}_shape", np.array(shape, np.int64))
            self._node("Reshape", [self._t(tensor), dims], name)
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    # Operators.

    def _convolution(self, op: Operator) -> None:
        """TFLite has weights (out, h, w, in), and (1, h, w, channels) if depthwise."""
        source, (top, left, bottom, right) = self._unpadded(op.inputs[0])
        weights, bias = (array(self.graph.constants[index]) for index in op.inputs[1:3])
        depthwise = op.kind == "DEPTHWISE_CONV_2D"
        if depthwise and op.options.depthMultiplier != 1:
            raise ValueError("depthwise convolution with a multiplier")
        if op.options.dilationHFactor != 1 or op.options.dilationWFactor != 1:
            raise ValueError("dilated convolution")
        weights = weights.transpose(3, 0, 1, 2) if depthwise else weights.transpose(0, 3, 1, 2)
        kernel, strides = list(weights.shape[2:]), [op.options.strideH, op.options.strideW]
        same = self.graph.window_padding(op, kernel, strides)
        self._conv(
            self._t(source), self._output_name(op), weights, bias,
            strides=strides, group=weights.shape[0] if depthwise else 1,
            pads=[a + b for a, b in zip(same, (top, left, bottom, right))],
        )

    def _conv(self, source: str, output: str, weights: np.ndarray,
              bias: np.ndarray | None = None, **attributes: object) -> str:
        inputs = [source, self._initializer(f"{output}_w", weights.astype(np.float32))]
        if bias is not None:
            inputs.append(self._initializer(f"{output}_b", bias))
        kernel = list(weights.shape[2:])
        return self._node("Conv", inputs, output, kernel_shape=kernel, **attributes)

    def _output_name(self, op: Operator) -> str:
        if op.options.fusedActivationFunction != ACTIVATION_NONE:
            raise ValueError(f"{op.kind} with a fused activation")
        return self._t(op.outputs[0])

    def _unpadded(self, tensor: int) -> tuple[int, list[int]]:
        """The tensor before a PAD of rows and columns, and its top, left, bottom, right."""
        return self.rows_and_columns_padding.get(tensor, (tensor, [0, 0, 0, 0]))

    def _prelu(self, op: Operator) -> None:
        source, output = self._t(op.inputs[0]), self._t(op.outputs[0])
        slope = array(self.graph.constants[op.inputs[1]]).reshape(-1, 1, 1, 1)
        if not self.blocked:
            self._node("PRelu", [source, self._initializer(f"{output}_slope", slope[:, 0])], output)
            return
        depthwise = {"group": len(slope)}
        negated = self._conv(source, f"{output}_neg", -np.ones_like(slope), **depthwise)
        negative_part = self._node("Relu", [negated], f"{output}_relu")
        scaled = self._conv(negative_part, f"{output}_scaled", 1 - slope, **depthwise)
        self._node("Add", [source, scaled], output)

    def _add(self, op: Operator) -> None:
        self._node("Add", [self._t(index) for index in op.inputs], self._output_name(op))

    def _max_pool(self, op: Operator) -> None:
        kernel = [op.options.filterHeight, op.options.filterWidth]
        strides = [op.options.strideH, op.options.strideW]
        self._node(
            "MaxPool", [self._t(op.inputs[0])], self._output_name(op),
            kernel_shape=kernel, strides=strides, pads=self.graph.window_padding(op, kernel, strides),
        )

    def _pad(self, op: Operator) -> None:
        source, output = op.inputs[0], op.outputs[0]
        pads, channels = self.graph.pad(op)
        if channels:
            self._pad_channels(source, output, channels)
        else:
            self.rows_and_columns_padding[output] = (source, pads)

    def _pad_channels(self, source: int, output: int, added: int) -> None:
        if self.blocked:
            channels = self.graph.shapes[source][3]
            eye = np.eye(channels + added, channels)
            self._conv(self._t(source), self._t(output), eye[:, :, None, None])
        else:
            pads = np.array([0, 0, 0, 0, 0, added, 0, 0], np.int64)
            inputs = [self._t(source), self._initializer(f"{self._t(output)}_pads", pads)]
            self._node("Pad", inputs, self._t(output))

    def _reshape(self, op: Operator) -> None:
        """Transposes to NHWC first, so that the elements keep TFLite's order."""
        source, output = self._t(op.inputs[0]), self._t(op.outputs[0])
        rows_last = self._node("Transpose", [source], f"{output}_nhwc", perm=[0, 2, 3, 1])
        shape = np.array(self.graph.shapes[op.outputs[0]], np.int64)
        self._node("Reshape", [rows_last, self._initializer(f"{output}_shape", shape)], output)

    def _concatenation(self, op: Operator) -> None:
        if len(self.graph.shapes[op.outputs[0]]) != 3:
            raise ValueError("concatenation of feature maps")
        inputs = [self._t(index) for index in op.inputs]
        self._node("Concat", inputs, self._output_name(op), axis=op.options.axis)


def array(constant: Constant) -> np.ndarray:
    """A constant of the file in single precision."""
    return np.frombuffer(constant.data, f"<{constant.format}").reshape(constant.shape).astype(np.float32)


def nchw(shape: tuple[int, ...]) -> list[int]:
    """Converts a TFLite shape to ONNX order. Only shapes of 4 axes have channels."""
    if len(shape) != 4:
        return list(shape)
    return [shape[0], shape[3], shape[1], shape[2]]
