#!/usr/bin/env python3
"""Judges the sideways gaze on films of real people, whose true gaze nobody knows, by a plain geometric reference.

The reference is the offset of each iris from the middle of its eye's corners in the plane of the face, divided by
0.384 of the eye's width; the arcsine of the mean of both eyes is the angle. It is computed here from the landmarks that
`facewire track` writes, apart from facewire's own code. Its own noise is about 1 degree, so that a film in which the eyes
move by less tells little.

    pip install numpy
    fit/real_gaze.py film.avi another.avi
    fit/real_gaze.py film.avi --curves another-tracker.csv

Films are those that `facewire track` takes: convert others by `ffmpeg -i film.mp4 -c:v mjpeg -q:v 2 -an film.avi`.
`--curves` judges the curves of another tracker (one CSV file for each film, with ARKit's names). Set FACEWIRE to the
program if it is not in the path.
"""

import argparse
import csv
import os
import pathlib
import subprocess
import tempfile

import numpy as np

# Corner at the person's left, corner at the right, and iris of each eye.
EYES = ((263, 362, 473), (133, 33, 468))
RADIUS, FULL_DEG = 0.384, 35
# Outer corners of the eyes at the person's left and right, between the brows, and below the nose.
LEFT, RIGHT, BROWS, NOSE = 263, 33, 168, 2


def reference_deg(landmarks):
    """Returns the angle to the person's left for each frame of landmarks (frames x 478 x 3)."""
    across = landmarks[:, LEFT] - landmarks[:, RIGHT]
    forward = np.cross(across, landmarks[:, NOSE] - landmarks[:, BROWS])
    up = np.cross(forward, across)
    axes = np.stack([axis / np.linalg.norm(axis, axis=1, keepdims=True) for axis in (across, up)], 1)
    face = np.einsum("fpk,fak->fpa", landmarks, axes)
    offsets = []
    for left, right, iris in EYES:
        across = face[:, left] - face[:, right]
        from_middle = face[:, iris] - (face[:, left] + face[:, right]) / 2
        offsets.append((from_middle * across).sum(1) / (across**2).sum(1))
    return np.degrees(np.arcsin(np.clip(np.mean(offsets, axis=0) / RADIUS, -1, 1)))


def gaze_deg(path):
    """Returns the angle to the person's left in each row of a file of curves."""
    with open(path, newline="") as file:
        rows = [{name.lower(): value for name, value in row.items()} for row in csv.DictReader(file)]
    curve = lambda name: np.array([float(row["eyelook" + name]) for row in rows])
    return (curve("outleft") - curve("inleft") + curve("inright") - curve("outright")) / 2 * FULL_DEG


def main():
    """Prints a row for each film."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("films", nargs="+", type=pathlib.Path, metavar="FILM")
    parser.add_argument("--curves", nargs="+", type=pathlib.Path, help="curves of another tracker in place of facewire's")
    arguments = parser.parse_args()
    if arguments.curves and len(arguments.curves) != len(arguments.films):
        parser.error("give one file of curves for each film")
    print("| film | frames with a face | deviation (degrees) | r | slope |\n|---|---|---|---|---|")
    for index, film in enumerate(arguments.films):
        with tempfile.TemporaryDirectory() as folder:
            landmarks, own = f"{folder}/landmarks.npy", f"{folder}/curves.csv"
            command = [os.environ.get("FACEWIRE", "facewire"), "track", film, "--neutral", "auto"]
            subprocess.run([*command, "--landmarks", landmarks, "--out", own], check=True, stderr=subprocess.DEVNULL)
            reference = reference_deg(np.load(landmarks).astype(float))
            gaze = gaze_deg(arguments.curves[index] if arguments.curves else own)
        if len(gaze) != len(reference):
            parser.error(f"{film} has {len(reference)} frames, its curves have {len(gaze)}")
        seen = np.isfinite(reference) & np.isfinite(gaze)
        reference, gaze = reference[seen], gaze[seen]
        r, slope = np.corrcoef(reference, gaze)[0, 1], np.polyfit(reference, gaze, 1)[0]
        print(f"| {film.stem} | {seen.sum()} | {reference.std():.1f} | {r:.2f} | {slope:.2f} |", flush=True)


if __name__ == "__main__":
    main()
