#!/usr/bin/env python3
"""Writes MediaPipe's landmarks of the built-in clip to demo-landmarks.npy beside this file.

Run by the Python that `scripts/setup compare` sets up: ~/.cache/facewire/venv-compare/bin/python tests/golden/make.py
"""

from pathlib import Path

import cv2
import mediapipe
import numpy as np

HERE = Path(__file__).resolve().parent
CLIP = HERE / "../../src/capture/demo.avi"
STRIDE = 8  # frames from one that is kept to the next
STEPS = 32  # values in a pixel


def landmarks(mesh, frame):
    """The points of the only face in a frame: x, y, z in pixels."""
    (face,) = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)).multi_face_landmarks
    width, height = frame.shape[1], frame.shape[0]
    return [[point.x * width, point.y * height, point.z * width] for point in face.landmark]


def main():
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    film = cv2.VideoCapture(str(CLIP))
    found = []
    while (read := film.read())[0]:
        found.append(landmarks(mesh, read[1]))
    steps = np.round(np.array(found[::STRIDE]) * STEPS).astype("<i2")
    np.save(HERE / "demo-landmarks.npy", steps)
    print(f"{len(found)} frames, {len(steps)} of them kept")


main()
