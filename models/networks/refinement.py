"""Compares the tables of face/src/track/refinement.rs with MediaPipe's own files.

The options of the custom operators in the attention mesh say where to crop the feature map.
The LandmarksRefinementCalculator of MediaPipe's face graph says which points a head replaces
and which points give an iris its depth. If a number differs, nothing is installed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from flatbuffers import flexbuffers

from sources import SetupError
from tflite_graph import Graph, read

RUST_TABLES = Path(__file__).parents[2] / "face/src/track/refinement.rs"

# Each head in the Rust tables, with the last tensor of the head in the attention mesh. The
# tables name an eye by the person's own side, MediaPipe by the side of the picture.
HEADS = {"LIPS": "conv_lips", "RIGHT_EYE": "conv_left_eye", "LEFT_EYE": "conv_right_eye"}

# Order of the inputs of the LandmarksRefinementCalculator, after the mesh itself.
REFINEMENTS = ("LIPS", "RIGHT_EYE", "LEFT_EYE", "RIGHT_IRIS", "LEFT_IRIS")

# Field numbers of mediapipe/framework/calculator.proto and
# mediapipe/calculators/util/landmarks_refinement_calculator.proto.
NODE_CALCULATOR, NODE_OPTIONS, REFINEMENT = 2, 7, 1
INDEXES_MAPPING, Z_REFINEMENT = 1, 2
Z_NONE, Z_COPY, Z_ASSIGN_AVERAGE = 1, 2, 3


@dataclass
class Refinement:
    """The points that one output replaces, the rule for their z, and the points it uses."""

    points: list[int]
    z_rule: int
    z_points: list[int]


def crop_of(graph: Graph, end: str) -> int:
    """The crop of the feature map from which the tensor named `end` is computed."""
    tensor = graph.tensor_named(end)
    while (operator := graph.producer(tensor)).kind != "TransformTensorBilinear":
        tensor = operator.inputs[0]
    return tensor


def check(attention: bytes, graphs: bytes) -> None:
    """Raises SetupError if the Rust tables differ from the two sources."""
    rust = rust_constants(RUST_TABLES.read_text(encoding="utf-8"))
    expected = {**operator_constants(attention), **graph_constants(graphs)}
    for name, value in expected.items():
        if rust.get(name) != value:
            raise SetupError(f"{RUST_TABLES}: {name} is {rust.get(name)}, it should be {value}")


def rust_constants(source: str) -> dict[str, list[float]]:
    """The numbers of every `const NAME: TYPE = ...;`, those of a scalar as a list of one."""
    found = re.findall(r"const (\w+): (?:\[\w+; \d+\]|\w+) =\s+([^;]+);", source)
    return {name: [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?", value)]
            for name, value in found}


def operator_constants(attention: bytes) -> dict[str, list[float]]:
    """The constants of the crops, from the options of the custom operators."""
    graph = read(attention)
    found: dict[str, list[float]] = {}
    for head, end in HEADS.items():
        bilinear = graph.producer(crop_of(graph, end))
        features, matrix = bilinear.inputs
        to_matrix = graph.producer(matrix)
        options = flexbuffers.Loads(to_matrix.custom_options)
        scaled = graph.producer(to_matrix.inputs[0])
        _, height, width, channels = graph.shapes[features]
        found[head] = options["subset_idxs"]
        found[f"{head}_ROTATION"] = [options["left_rotation_idx"], options["right_rotation_idx"]]
        shared = {
            "CROP_SIZE": _only({options["output_height"], options["output_width"],
                                *flexbuffers.Loads(bilinear.custom_options).values()}),
            "CROP_SCALE": _only({options["scale_x"], options["scale_y"]}),
            "TARGET_ANGLE": [options["target_rotation_radians"]],
            "FEATURE_SIZE": _only({height, width}),
            "FEATURE_CHANNELS": [channels],
            "FEATURE_SCALE": graph.constants[scaled.inputs[1]].values(),
        }
        if any(found.setdefault(name, value) != value for name, value in shared.items()):
            raise SetupError("the three heads of the attention mesh differ in their crops")
        _check_translation(graph, matrix, 1 / shared["FEATURE_SCALE"][0])
    return found


def _check_translation(graph: Graph, matrix: int, factor: float) -> None:
    """Checks that points are mapped back by the crop's matrix, its translation (column 3) times
    `factor`."""
    multiply = next(o for o in graph.operators if matrix in o.inputs and o.kind == "MUL")
    factors = graph.constants[multiply.inputs[1]].values()
    rows = [factors[at:at + 4] for at in range(0, 16, 4)]
    if any(row[:2] != [1, 1] or row[3] != factor for row in rows[:2]):
        raise SetupError(f"the map from crop to picture scales by {rows}")


def _only(values: set[float]) -> list[float]:
    if len(values) != 1:
        raise SetupError(f"the attention mesh has different sizes: {values}")
    return list(values)


def graph_constants(graphs: bytes) -> dict[str, list[float]]:
    """The index lists of the LandmarksRefinementCalculator."""
    mesh, *parts = refinements(graphs)
    if mesh.points != list(range(468)) or mesh.z_rule != Z_COPY:
        raise SetupError("the refinement does not start from the 468 points of the mesh")
    found: dict[str, list[float]] = {}
    for name, part in zip(REFINEMENTS, parts):
        found[name] = part.points
        iris = name.endswith("IRIS")
        if part.z_rule != (Z_ASSIGN_AVERAGE if iris else Z_NONE):
            raise SetupError(f"unexpected rule {part.z_rule} for the depth of {name}")
        if iris:
            found[f"{name}_DEPTH"] = part.z_points
    return found


def refinements(graphs: bytes) -> list[Refinement]:
    """Reads the calculator's options from the graphs that are compiled into MediaPipe.

    A graph is a serialised protocol buffer. The node of the calculator starts with its name,
    and the two bytes before it are the length of the node.
    """
    name = b"LandmarksRefinementCalculator"
    start = graphs.index(bytes([NODE_CALCULATOR << 3 | 2, len(name)]) + name)
    length, _ = _varint(graphs, start - 2)
    options = _only_field(graphs[start:start + length], NODE_OPTIONS)
    [(_, extension)] = _fields(options)
    return [_refinement(value) for number, value in _fields(extension) if number == REFINEMENT]


def _refinement(message: bytes) -> Refinement:
    points = [value for number, value in _fields(message) if number == INDEXES_MAPPING]
    [(rule, content)] = _fields(_only_field(message, Z_REFINEMENT))
    return Refinement(points, rule, [value for _, value in _fields(content)])


def _only_field(message: bytes, number: int) -> bytes:
    [value] = [value for found, value in _fields(message) if found == number]
    return value


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """The fields of a protocol buffer with only varints and length-delimited fields."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        value, at = _varint(message, at)
        if key & 7 == 2:
            value, at = message[at:at + value], at + value
        elif key & 7 != 0:
            raise ValueError(f"wire type {key & 7}")
        yield key >> 3, value


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte, at = message[at], at + 1
        value, shift = value | (byte & 127) << shift, shift + 7
        if byte < 128:
            return value, at
