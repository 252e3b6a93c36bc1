#!/usr/bin/env python3
"""Writes the tables of fit/README.md and fit/FIGURES.md that say how good the built-in model is.

    cargo build --release -p facewire-fit    # again after a change of the model
    fit/figures.py FOLDER

FOLDER holds the rendered videos and the results. Existing videos are used again: after a change of the renderer or of the
networks, use another folder. Needs the rig and the recordings of README.md, and ../shared/dataset. FACEWIRE_FIT is the program,
if it is not target/release/facewire-fit.

  --keep   also uses the existing results in FOLDER, and only writes the tables
  --into F writes into the folder F with a README.md and a FIGURES.md, instead of into fit/
"""

import argparse
import json
import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "packet/python"))

from facewire_packet import NAMES  # noqa: E402 (of the blendshapes in order, tongueOut last)

DATASET = "../shared/dataset/train.npz"
CONDITIONS = ("beard", "glasses", "side-light", "occluded", "dark", "small")
STATES = ("known", "not_known")
LEAST_SLOPE = 0.75


def commands():
    """Each set's name, what makes its faces in the folder {0}, and what judges them."""
    synth = "synth {0}/%s/faces.npz --seed 1 --set judge "
    judge = "judge {0}/%s/faces.npz --all-subjects"
    yield "videos", "film {0}/clips --count 20 --seconds 10", "judge {0}/clips"
    yield "judging", synth % "judging" + "--pictures 3000 --per-subject 20", judge % "judging"
    yield "dataset", None, f"judge {DATASET}"
    for name in CONDITIONS:
        yield name, synth % name + f"--pictures 600 --per-subject 6 --condition {name}", judge % name


def run(folder):
    """Renders what is missing, and judges all sets."""
    program = os.environ.get("FACEWIRE_FIT", "target/release/facewire-fit")
    for name, make, judge in commands():
        made = folder / f"{name}.made"
        if make and not made.exists():
            subprocess.run([program, *(word.format(folder) for word in make.split())], check=True, cwd=ROOT)
            made.touch()
        out = folder / f"{name}.json"
        subprocess.run([program, *(word.format(folder) for word in judge.split()), "--json", out], check=True, cwd=ROOT)


def neutral_states(set_of_faces):
    """The figures of the model by row and phase, with the neutral face known and not known."""
    found = {name.removeprefix("neutral_face_"): state for name, state in set_of_faces["neutral"].items()}
    return [found[state]["model"]["figures"] for state in STATES]


def number(value, decimals):
    return "-" if value is None else f"{value:.{decimals}f}"


def value(figures, row, figure, decimals):
    return number(figures[row]["all"][figure]["value"], decimals)


def bounds(figures, row):
    """The lower and the upper end of the interval of r."""
    interval = figures[row]["all"]["r"]["interval"]
    return [interval[end] for end in ("low", "high")]


def results(sets):
    """The table of README.md."""
    titles = {"videos": "videos", "judging": "judging set", "dataset": "`../shared/dataset`"}
    lines = ["| judged on | known neutral face: r | MSE | slope | not known: r | MSE | slope |", "|---|---|---|---|---|---|---|"]
    for name, title in titles.items():
        cells = [title]
        for figures in neutral_states(sets[name]):
            row = "mean_of_blendshapes"
            low, high = bounds(figures, row)
            cells.append(f"{value(figures, row, 'r', 3)} ({low:.3f} .. {high:.3f})")
            cells += [value(figures, row, "mse", 4), value(figures, row, "slope", 2)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def weak(sets):
    """The sentences of README.md about single coefficients in the videos. Both sides are named once, with their mean."""
    known, not_known = neutral_states(sets["videos"])
    slopes = {}
    for name, phases in known.items():
        slope = phases["all"]["slope"]["value"]
        if slope is not None and not name.startswith("mean_of"):
            slopes.setdefault(re.sub("(?<!^mouth)(?<!^jaw)(Left|Right)$", "", name), []).append(slope)
    means = {name: sum(sides) / len(sides) for name, sides in slopes.items()}
    listed = [f"{name} ({mean:.2f})" for name, mean in sorted(means.items(), key=lambda item: item[1]) if mean < LEAST_SLOPE]
    jitter = [value(figures, "mean_of_blendshapes", "jitter", 4) for figures in (known, not_known)]
    sentence = f"Slopes below {LEAST_SLOPE} in the videos, known: {', '.join(listed) or 'none'}. "
    return wrapped(sentence + f"Jitter at rest is {jitter[0]} known, {jitter[1]} not known.")


def wrapped(text, columns=128):
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > columns:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return "\n".join(lines)


def conditions(sets):
    """The table of README.md by condition, the best first."""
    figures = {name: neutral_states(sets[name])[0]["mean_of_blendshapes"]["all"] for name in CONDITIONS}
    names = sorted(figures, key=lambda name: -figures[name]["r"]["value"])
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for title, figure, decimals in [("r", "r", 3), ("MSE", "mse", 4)]:
        cells = [number(figures[name][figure]["value"], decimals) for name in names]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n".join(lines)


def blendshapes(sets):
    """The table of FIGURES.md."""
    states = [figures for name in ("judging", "dataset") for figures in neutral_states(sets[name])]
    heads = ["judge, known: r", "MSE", "not known: r", "MSE", "dataset, known: r", "MSE", "not known: r", "MSE"]
    lines = [f"| blendshape | {' | '.join(heads)} |", "|---" * 9 + "|"]
    for row in [*NAMES[:-1], "mean_of_blendshapes"]:
        cells = ["mean of 51" if row.startswith("mean_of") else row]
        for figures in states:
            low, high = bounds(figures, row)
            half = "" if figures[row]["all"]["r"]["value"] is None else f" ± {(high - low) / 2:.3f}"
            cells += [value(figures, row, "r", 3) + half, value(figures, row, "mse", 4)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def write(path, tables):
    """Replaces what stands between the marks of each table."""
    text = path.read_text()
    for name, table in tables.items():
        begin, end = f"<!-- figures.py: {name} -->\n", f"<!-- figures.py: end of {name} -->\n"
        before, rest = text.split(begin)
        text = before + begin + "\n" + table + "\n\n" + end + rest.split(end)[1]
    path.write_text(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--into", type=pathlib.Path, default=ROOT / "fit")
    args = parser.parse_args()
    folder = args.folder.absolute()
    if not args.keep:
        folder.mkdir(parents=True, exist_ok=True)
        run(folder)
    sets = {name: json.loads((folder / f"{name}.json").read_text())["sets"][0] for name, _, _ in commands()}
    tables = {"results": results(sets), "weak": weak(sets), "conditions": conditions(sets)}
    write(args.into / "README.md", tables)
    write(args.into / "FIGURES.md", {"blendshapes": blendshapes(sets)})


if __name__ == "__main__":
    main()
