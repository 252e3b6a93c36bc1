"""Cuts the TFLite files into the five networks that facewire runs.

The attention mesh contains operators that no other runtime knows. They compute where to
crop the feature map for the lips and the eyes, crop it, and map the points back. facewire
does this itself, so the network is cut into four plain ones between these operators.
"""

from __future__ import annotations

from dataclasses import dataclass

from refinement import crop_of
from tflite_graph import Graph, read


@dataclass
class Network:
    """A part of a TFLite file, the name of its input, and the names of its outputs with their shapes in ONNX."""

    name: str
    file: bytes
    graph: Graph
    input: str
    outputs: dict[str, list[int]]


def all_networks(detector: bytes, attention: bytes) -> list[Network]:
    """Cuts the two TFLite files into the networks that facewire runs."""
    return [
        _detector(detector),
        _mesh(attention),
        _head(attention, "lips", {"points": ("conv_lips", 160)}),
        _head(attention, "left_eye",
              {"points": ("conv_left_eye", 142), "iris": ("conv_left_iris", 10)}),
        _head(attention, "right_eye",
              {"points": ("conv_right_eye", 142), "iris": ("conv_right_iris", 10)}),
    ]


def _detector(content: bytes) -> Network:
    graph = read(content)
    ends = [graph.tensor_named(name) for name in ("regressors", "classificators")]
    part = graph.cut([graph.tensor_named("input")], ends)
    return Network("detector", content, part, "image", {"boxes": [1, 896, 16], "scores": [1, 896, 1]})


def _mesh(content: bytes) -> Network:
    graph = read(content)
    ends = [graph.tensor_named(name) for name in ("output_mesh", "conv_faceflag")]
    ends.append(graph.producer(crop_of(graph, "conv_lips")).inputs[0])
    part = graph.cut([graph.tensor_named("input_1")], ends)
    outputs = {"mesh": [1, 1404], "flag": [1, 1], "features": [1, 32, 48, 48]}
    return Network("mesh", content, part, "image", outputs)


def _head(content: bytes, name: str, outputs: dict[str, tuple[str, int]]) -> Network:
    graph = read(content)
    ends = [graph.tensor_named(tensor) for tensor, _ in outputs.values()]
    part = graph.cut([crop_of(graph, outputs["points"][0])], ends)
    return Network(name, content, part, "crop", {key: [1, size] for key, (_, size) in outputs.items()})
