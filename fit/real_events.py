#!/usr/bin/env python3
"""Judges the coefficients on films of real people by movements that were marked by eye.

`tests/real-events.csv` names intervals of frames in which a movement is clearly present, and others in which it is clearly
absent. The first marks were made before any estimate was seen. Afterwards, 8 places that two trackers contradicted were corrected
(README.md). The score of an interval is the highest estimate in it. An event counts as found, and an interval of absence
as a false alarm, if its score reaches the threshold. The columns are

    F1    2 * found / (2 * found + missed + false alarms)
    J     share of the events that are found, minus share of the absent ones that are false alarms (Youden's index)
    AUC   probability that a present event scores higher than an absent one (area under the ROC curve). It needs no
          threshold, so that it does not reward larger curves, as F1 and J may
    peaks mean score of present and of absent events: how large the movement is drawn, and how large its absence

Means are over coefficients with at least 3 intervals of each kind; rows of a group contain those of the group. The row of
deviations has the standard deviation of the mean of all of them over films that are drawn again (bootstrap, fixed seed).

    pip install numpy
    fit/real_events.py lp_d0.avi lp_d3.avi ...
    fit/real_events.py lp_d0.avi --neutral auto --model new.toml
    fit/real_events.py lp_d0.avi --curves another-tracker.csv

Films are those that `facewire track` takes, named after the clips of the marks: convert others by
`ffmpeg -i film.mp4 -c:v mjpeg -q:v 2 -an film.avi`. `--curves` judges the curves of another tracker (one CSV file for each
film, with ARKit's names). Set FACEWIRE to the program if it is not in the path.
"""

import argparse
import collections
import csv
import os
import pathlib
import subprocess
import tempfile

import numpy as np

MARKS = pathlib.Path(__file__).parent / "tests/real-events.csv"
THRESHOLDS = (0.2, 0.3)
FEWEST, RESAMPLES = 3, 200
# A coefficient belongs to the first group whose prefix its name has.
GROUPS = {"gaze": "eyeLook", "lids": "eye", "brows": "brow", "mouth, jaw, cheeks, nose": ""}


def read_curves(path):
    """Returns a dictionary from names in lower case to curves; frames without a face have 0."""
    with open(path, newline="") as file:
        rows = [{name.lower(): value for name, value in row.items()} for row in csv.DictReader(file)]
    return {name: np.nan_to_num([float(row[name] or 0) for row in rows]) for name in rows[0] if name != "state"}


def track(film, options):
    """Returns the curves of one film by `facewire track`."""
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/curves.csv"
        command = [os.environ.get("FACEWIRE", "facewire"), "track", film, *options, "--out", out]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        return read_curves(out)


def scores_of(clip, curves, marks):
    """Returns (coefficient, state, score) for each mark of one clip."""
    scores = []
    for mark in marks:
        curve = curves.get(mark["coefficient"].lower())
        if mark["clip"] == clip and curve is not None:
            interval = curve[int(mark["first"]) : int(mark["last"]) + 1]
            if not len(interval):
                raise SystemExit(f"{clip} has {len(curve)} frames, but a mark begins at {mark['first']}")
            scores.append((mark["coefficient"], mark["state"], interval.max()))
    return scores


def figures(present, absent):
    """Returns F1 and J at each threshold, the area under the ROC curve, and both mean peaks."""
    row = []
    for threshold in THRESHOLDS:
        found, false = (present >= threshold).sum(), (absent >= threshold).sum()
        row += [2 * found / max(found + len(present) + false, 1), found / len(present) - false / len(absent)]
    difference = present[:, None] - absent
    return [*row, np.mean((difference > 0) + (difference == 0) / 2), present.mean(), absent.mean()]


def line(name, present, absent, row):
    """Prints one row of the table."""
    print(f"| {name} | {present} | {absent} |", " | ".join("" if np.isnan(x) else f"{x:.2f}" for x in row), "|")


def rows_of(films):
    """Returns name, numbers of present and absent intervals, and figures of each coefficient."""
    scores, rows = collections.defaultdict(list), []
    for name, state, score in (entry for film in films for entry in film):
        scores[name, state].append(score)
    for name in sorted({name for name, _ in scores}):
        present, absent = (np.array(scores[name, state]) for state in ("present", "absent"))
        peaks = [values.mean() if len(values) else np.nan for values in (present, absent)]
        row = figures(present, absent) if len(present) and len(absent) else [np.nan] * 5 + peaks
        rows.append((name, len(present), len(absent), row))
    return rows


def mean_of(rows):
    """Returns how many rows have intervals enough, the sums of their numbers of intervals, and their mean figures."""
    rows = [row for row in rows if min(row[1:3]) >= FEWEST]
    present, absent = (sum(row[k] for row in rows) for k in (1, 2))
    return len(rows), present, absent, sum(np.array(row[3]) for row in rows) / max(len(rows), 1)


def print_table(films):
    """Prints a row for each coefficient, then the means."""
    heads = [f"{figure} at {t}" for t in THRESHOLDS for figure in ("F1", "J")] + ["AUC", "peak present", "peak absent"]
    print("| coefficient | present | absent |", " | ".join(heads), "|\n|---|---|---|" + "---|" * len(heads))
    rows = rows_of(films)
    for row in rows:
        line(*row)
    group_of = lambda name: next(group for group, prefix in GROUPS.items() if name.startswith(prefix))
    for group in [*GROUPS, "all"]:
        number, *mean = mean_of([row for row in rows if group in ("all", group_of(row[0]))])
        if number:
            line(f"**mean of {number}: {group}**", *mean)
    draws = np.random.default_rng(0).integers(len(films), size=(RESAMPLES, len(films)))
    means = [mean_of(rows_of([films[k] for k in draw]))[-1] for draw in draws]
    if number:
        line("deviation of the mean of all", "", "", np.std(means, axis=0))


def main():
    """Judges all films together."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("films", nargs="+", type=pathlib.Path, metavar="FILM")
    parser.add_argument("--marks", type=pathlib.Path, default=MARKS, help="the file of marks")
    parser.add_argument("--curves", nargs="+", type=pathlib.Path, help="curves of another tracker in place of facewire's")
    parser.add_argument("--neutral", help="passed to `facewire track`: `auto`, or frames A..B; without it, not known")
    parser.add_argument("--model", help="passed to `facewire track`")
    parser.add_argument("--config", help="passed to `facewire track`")
    arguments = parser.parse_args()
    if arguments.curves and len(arguments.curves) != len(arguments.films):
        parser.error("give one file of curves for each film")
    marks = list(csv.DictReader(arguments.marks.read_text().splitlines()))
    passed = {"--neutral": arguments.neutral, "--model": arguments.model, "--config": arguments.config}
    options = [text for option, value in passed.items() if value for text in (option, value)]
    films = []
    for index, film in enumerate(arguments.films):
        curves = read_curves(arguments.curves[index]) if arguments.curves else track(film, options)
        films.append(scores_of(film.stem, curves, marks))
    if not any(films):
        parser.error("the marks name none of these films")
    print_table(films)


if __name__ == "__main__":
    main()
