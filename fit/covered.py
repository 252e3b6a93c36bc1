#!/usr/bin/env python3
"""Prints what is estimated of faces of which a part is covered, beside faces in view, on clips of `facewire-fit film`.

    for condition in headset mask hand microphone sunglasses rims fringe strange; do
        facewire-fit film clips/$condition --count 4 --seconds 5 --condition $condition
    done
    facewire-fit film clips/none --count 4 --seconds 5
    pip install numpy
    fit/covered.py clips

All conditions show the same people with the same expressions. The neutral face is taken from the first ten frames, in which the
face is covered, too. Columns: r and mean squared error of brows and eyes (upper) and of mouth and jaw (lower); the mean of the
covered coefficients and their mean change from frame to frame; the mean visibility of left eye, right eye, brows, mouth and
cheeks. r is the mean over coefficients that move. Set FACEWIRE to the program if it is not in the path.
"""

import csv
import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

UPPER, LOWER = ("brow", "eye"), ("mouth", "jaw")
# The beginnings of the names of the coefficients that each condition covers.
COVERED = {"headset": UPPER, "mask": LOWER, "hand": LOWER, "microphone": LOWER, "sunglasses": ("eye",), "fringe": ("brow",)}
REGIONS = ("left_eye", "right_eye", "brows", "mouth", "cheeks")
LEAST_DEVIATION = 0.03


def read(path):
    """Returns the columns of a table by their names in lower case. What is missing is 0."""
    with open(path, newline="") as file:
        rows = [{name.lower(): value for name, value in row.items()} for row in csv.DictReader(file)]
    names = [name for name in rows[0] if name != "state"]
    return {name: np.array([float(row[name] or 0) for row in rows]) for name in names}


def figures(found, truth, prefixes):
    """Returns r and the mean squared error of the coefficients whose names begin so."""
    names = [name for name in truth if name.startswith(prefixes)]
    moving = [name for name in names if truth[name].std() > LEAST_DEVIATION and found[name].std() > 1e-6]
    r = [np.corrcoef(found[name], truth[name])[0, 1] for name in moving]
    error = np.mean([(found[name] - truth[name]) ** 2 for name in names])
    return np.mean(r) if r else np.nan, error


def judge(clip, covered):
    """Returns the figures of one clip."""
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/curves.csv"
        command = [os.environ.get("FACEWIRE", "facewire"), "track", clip, "--neutral", "0..9", "--out", out]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        found = read(out)
    truth = read(clip.with_suffix(".csv"))
    hidden = [found[name] for name in truth if name.startswith(covered)] if covered else [np.full(2, np.nan)]
    visible = [found[f"visibility_{region}"].mean() for region in REGIONS]
    trembling = np.mean([np.abs(np.diff(curve)).mean() for curve in hidden])
    return [*figures(found, truth, UPPER), *figures(found, truth, LOWER), np.mean(hidden), trembling, *visible]


def main():
    """Judges the clips of each folder."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        raise SystemExit(__doc__)
    heads = ["upper r", "MSE", "lower r", "MSE", "covered", "change", *REGIONS]
    print("|".join(["", " condition ", *(f" {head} " for head in heads), ""]))
    print("|" + "|".join(["---"] + ["---:"] * len(heads)) + "|")
    for folder in sorted(path for path in pathlib.Path(sys.argv[1]).iterdir() if path.is_dir()):
        rows = [judge(clip, COVERED.get(folder.name)) for clip in sorted(folder.glob("*.avi"))]
        if not rows:
            raise SystemExit(f"{folder} has no clips: render them, or remove it")
        digits = [2, 4, 2, 4, 3, 4, 2, 2, 2, 2, 2]
        with np.errstate(all="ignore"):
            means = np.mean(rows, 0)
        cells = ["" if np.isnan(mean) else f"{mean:.{count}f}" for mean, count in zip(means, digits)]
        print("|".join(["", f" {folder.name} ", *(f" {cell} " for cell in cells), ""]))


if __name__ == "__main__":
    main()
