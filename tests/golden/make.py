#!/usr/bin/env python3
"""Writes demo-landmarks.npy beside itself: what MediaPipe finds in the built-in clip.

Run by the Python that `scripts/setup compare` sets up: ~/.cache/facewire/venv-compare/bin/python tests/golden/make.py
"""

from pathlib import Path

import cv2
import mediapipe
import numpy as np

HERE = Path(__file__).resolve().parent
CLIP = HERE / "../../src/capture/demo.avi"
EVERY = 8  # frames
STEPS = 32  # of a pixel


def landmarks(mesh, frame):
    """The points of the only face: x, y, z in pixels."""
    (face,) = mesh.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)).multi_face_landmarks
    width, height = frame.shape[1], frame.shape[0]
    return [[point.x * width, point.y * height, point.z * width] for point in face.landmark]


def main():
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    film = cv2.VideoCapture(str(CLIP))
    found = []
    while (read := film.read())[0]:
        found.append(landmarks(mesh, read[1]))
    steps = np.round(np.array(found[::EVERY]) * STEPS).astype("<i2")
    np.save(HERE / "demo-landmarks.npy", steps)
    print(f"{len(found)} frames, {len(steps)} of them kept")


main()
