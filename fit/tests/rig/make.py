#!/usr/bin/env python3
"""Reduces a face rig to what the tests of `fit/` need, and writes it beside this file.

    fit/tests/rig/make.py ../shared/rig        (needs numpy and ffmpeg)

Vertices that share a cell, at rest as well as with an open jaw and shut eyes, become one: so lips and lids do not grow
together. The cells are small where the face moves. Every array keeps its name and its kind; see fit/README.md.
"""

import json
import pathlib
import shutil
import subprocess
import sys

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
SKIN = ["M_Face", "M_BackHead"]
PARTS = [SKIN, ["M_GumsTongue"], ["M_Teeth"], ["M_ScleraLeft"], ["M_ScleraRight"], ["M_EyeLashes"]]
CELLS_CM = [None, 1.4, 1.0, 0.6, 0.6, 0.4]
IDENTITIES = 3
# A picture of each kind, and the width that it is reduced to.
TEXTURES = [("skins/young_lightskinned_male2.jpg", 256), ("brows/eyebrow001.png", 200), ("eyes/brown_eye.png", 160)]


def skin_cell_cm(point):
    x, y, z = point
    if z > 5 and abs(x) < 5.2 and -6 < y < 6:
        return 0.3
    return 0.7 if z > 4.6 and y > -8.5 else 1.5


def main():
    source = pathlib.Path(sys.argv[1])
    rig, names = np.load(source / "rig.npz"), json.loads((source / "rig.json").read_text())
    neutral, landmarks = rig["neutral"], names["landmark68_vertices"]
    moved = [rig["expressions"][names["expressions"].index(name)] for name in ("jawOpen", "eyeBlink_L", "eyeBlink_R")]
    part_of = {names["materials"].index(name): part for part, group in enumerate(PARTS) for name in group}
    used = np.isin(rig["face_material"], list(part_of))
    faces, materials = rig["faces"][used], rig["face_material"][used]
    part = np.full(len(neutral), -1)
    for face, material in zip(faces, materials):
        part[face] = part_of[material]

    def key(vertex):
        cell = CELLS_CM[part[vertex]] or skin_cell_cm(neutral[vertex])
        rest, moves = np.floor(neutral[vertex] / cell), [np.round(offsets[vertex] / 0.8) for offsets in moved]
        return (part[vertex], cell, *rest, *np.concatenate(moves))

    # The first vertex of a cell stands for it, and landmarks come first.
    others = [vertex for vertex in range(len(neutral)) if part[vertex] >= 0]
    cells, kept, number = {}, [], {}
    for vertex in landmarks + others:
        cell = ("landmark", vertex) if vertex in landmarks else key(vertex)
        if vertex in landmarks:
            cells.setdefault(key(vertex), len(kept))
        if cell not in cells:
            cells[cell] = len(kept)
            kept.append(vertex)
        number.setdefault(vertex, cells[cell])
    joined = np.array([[number[vertex] for vertex in face] for face in faces], dtype=np.int32)
    whole = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    step = lambda values, size: (np.round(values / size) * size).astype(np.float32)
    np.savez_compressed(
        HERE / "rig.npz",
        neutral=step(neutral[kept], 1 / 128),
        expressions=step(rig["expressions"][:, kept], 1 / 128),
        identities=step(rig["identities"][:IDENTITIES, kept], 1 / 32),
        faces=joined[whole],
        face_material=materials[whole].astype(np.int32),
        skin_uv=step(rig["skin_uv"][kept], 1 / 2048),
    )
    names["landmark68_vertices"] = [number[vertex] for vertex in landmarks]
    (HERE / "rig.json").write_text(json.dumps(names) + "\n")
    shutil.copyfile(source / "LICENSE-ICT-FaceKit", HERE / "LICENSE-ICT-FaceKit")
    for name, width in TEXTURES:
        (HERE / name).parent.mkdir(exist_ok=True)
        out = HERE / name.replace("eye.png", "eye.jpg")
        scale = ["-vf", f"scale={width}:-1", "-map_metadata", "-1", "-q:v", "4", out]
        subprocess.run(["ffmpeg", "-loglevel", "error", "-y", "-i", source / name, *scale], check=True)
    print(f"{len(kept)} vertices, {whole.sum()} triangles")


main()
