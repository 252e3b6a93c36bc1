#!/usr/bin/env python3
"""Finds the typical readings of the poses of a calibration, and the powers of their gains, for the built-in model.

The figures stand in src/calibration/take.rs. They depend on the model, so find them again after `train`, `tune
correction` and `models/eyes/train.py`, with a program that contains the new model. FOLDER has clips of `facewire-fit film --script wearer`. A reading
is the median of the regression while the pose is held, less the rest of the neutral face. The power has the least mean
squared error over the judged part of the clips; `crossed` is the error of each half of the people with the figures of
the other half, which tells whether a gain carries over.

    pip install numpy
    fit/poses.py wearers

Set FACEWIRE to the program if it is not in the path.
"""

import csv
import os
import pathlib
import subprocess
import sys
import tempfile
import tomllib

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
POSES = {
    "eyes-shut": ["eyeBlinkLeft", "eyeBlinkRight"],
    "jaw-open": ["jawOpen"],
    "brows-up": ["browInnerUp", "browOuterUpLeft", "browOuterUpRight"],
    "brows-down": ["browDownLeft", "browDownRight"],
    "smile": ["mouthSmileLeft", "mouthSmileRight"],
    "pucker": ["mouthPucker"],
    "look-left": ["eyeLookOutLeft", "eyeLookInRight"],
    "look-right": ["eyeLookInLeft", "eyeLookOutRight"],
    "look-up": ["eyeLookUpLeft", "eyeLookUpRight"],
    "look-down": ["eyeLookDownLeft", "eyeLookDownRight"],
}
POWERS = (0, 0.25, 0.5, 0.75, 1)
# Frames of a take in which the pose is held, and those in which the neutral face is.
HELD, NEUTRAL = slice(36, 76), slice(15, 80)
LEAST_READING, GAIN, MOST_REST = 0.1, (0.6, 1.6), 0.3
CORRECTION = tomllib.loads((ROOT / "models/blendshapes.toml").read_text())["correction"]


def terms(name):
    """Returns shift, slope, lift and response of eq. 7 for a blendshape."""
    own = CORRECTION.get(name, {})
    return own.get("shift", 0), own.get("slope", 1), own.get("lift", 0), own.get("response", (0, 1))


def corrected(name, raw, rest, gain):
    """Eq. 7 as in face/src/solve/correction.rs."""
    shift, slope, lift, (begin, end) = terms(name)
    value = gain * (raw + shift - rest) / (1 - rest)
    part = np.clip((value - begin) / (end - begin), 0, 1)
    return np.clip((slope + lift * part**2 * (3 - 2 * part)) * value, 0, 1)


def person(film):
    """Returns the rest, the reading, and the judged results with their truth, for each blendshape of a pose."""
    with open(film.with_suffix(".parts.csv"), newline="") as file:
        begins = {row["part"]: (int(row["first_frame"]), int(row["frames"])) for row in csv.DictReader(file)}
    part = lambda rows, name: rows[begins[name][0]:sum(begins[name])]
    with tempfile.NamedTemporaryFile() as curves:
        begin = begins["neutral"][0]
        command = [os.environ.get("FACEWIRE", "facewire"), "track", film, "--stage", "raw", "--out", curves.name]
        subprocess.run([*command, "--neutral", f"{begin}..{begin + 90}"], check=True, stderr=subprocess.DEVNULL)
        estimates, truths = (list(csv.DictReader(open(path, newline=""))) for path in (curves.name, film.with_suffix(".csv")))
    found = {}
    for pose, names in POSES.items():
        for name in names:
            raw = np.array([float(row[name] or "nan") for row in estimates])
            truth = part(np.array([float(row[name]) for row in truths]), "judged")
            rest = np.clip(np.nanmedian(part(raw, "neutral")[NEUTRAL]) + terms(name)[0], 0, MOST_REST)
            found[name] = rest, np.nanmedian(part(raw, pose)[HELD]) - rest, part(raw, "judged"), truth
    return found


def typical(people, names):
    """Returns the mean reading of these people."""
    return np.mean([person[name][1] for person in people for name in names])


def error(people, names, typical, power):
    """Returns the mean squared error of these people with gains from this typical reading."""
    errors = []
    for name, (rest, reading, raw, truth) in ((name, person[name]) for person in people for name in names):
        gain = np.clip((typical / reading) ** power, *GAIN) if reading > LEAST_READING else 1
        errors.append(np.nanmean((corrected(name, raw, rest, gain) - truth) ** 2))
    return np.mean(errors)


def best(people, names):
    """Returns the typical reading and the power with the least error."""
    reading = typical(people, names)
    return reading, min(POWERS, key=lambda power: error(people, names, reading, power))


def main():
    """Prints a row for each pose."""
    films = sorted(pathlib.Path(sys.argv[1]).glob("*.avi")) if len(sys.argv) == 2 else sys.exit(__doc__)
    people = [person(film) for film in films]
    print("| pose | typical | power | MSE without a gain | with it | crossed |\n|---|---|---|---|---|---|")
    for pose, names in POSES.items():
        halves = people[::2], people[1::2]
        crossed = [error(other, names, *best(own, names)) for own, other in (halves, halves[::-1])]
        reading, power = best(people, names)
        errors = error(people, names, 1, 0), error(people, names, reading, power), np.mean(crossed)
        print(f"| {pose} | {reading:.2f} | {power} | " + " | ".join(f"{value:.4f}" for value in errors) + " |", flush=True)


if __name__ == "__main__":
    main()
