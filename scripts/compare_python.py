"""Measures MediaPipe for Python and the wheel of facewire alternately on the same pictures and one core.

In each round every side runs once, in a process of its own; the order changes from round to round. Pictures lie decoded in a
file, from which each is read into one array before the clock starts. The figures are medians over the rounds, ratios are the
medians of the ratios of the rounds, with the lowest and the highest of them.

FaceLandmarker needs its model, which MediaPipe's package does not contain: give the file face_landmarker.task with --model. Then
its results are compared, too, with those of the stand-in for FaceLandmarker and of a newer MediaPipe in the same pictures.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

FIGURES = {"p50_ms": "ms, p50", "p95_ms": "ms, p95", "cpu_ms": "ms of processor time, in the mean",
           "first_s": "s from import to first result", "memory_mb": "MB of memory",
           "before_mb": "MB of them before the import: Python, NumPy, a picture", "size_mb": "MB on disk"}
# MediaPipe's own landmarks of every 8th picture as FFmpeg decodes it, in 32nds of a pixel.
GOLDEN = pathlib.Path(__file__).resolve().parent.parent / "tests" / "golden" / "demo-landmarks.npy"
NEWER = "newer FaceLandmarker"
SIDES = ("FaceMesh", "FaceLandmarker", NEWER, "facewire", "facewire as FaceMesh", "facewire as FaceLandmarker")


def size_mb(python):
    """Returns the size of the packages that an environment has besides pip."""
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    folder = pathlib.Path(subprocess.run([python, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout.strip())
    tools = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    files = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sum(path.stat().st_size for path in files if not path.relative_to(folder).parts[0].startswith(tools)) / 1e6


def saved_by(args, side):
    """Returns what a side finds in every picture."""
    import numpy

    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "saved.npz")
        start(args, side, path)
        with numpy.load(path) as saved:
            return dict(saved)


def apart(points, others):
    """Returns how far points lie from others."""
    import numpy

    distances = numpy.linalg.norm(points - others, axis=2)
    return {"mean": float(distances.mean()), "worst": float(distances.max())}


def of_landmarkers(theirs, ours):
    """Returns how far the results of two FaceLandmarkers are apart in the same pictures."""
    import numpy

    turns = numpy.einsum("nij,nij->n", theirs["matrices"][:, :3, :3], ours["matrices"][:, :3, :3])
    angles = numpy.degrees(numpy.arccos(((turns - 1) / 2).clip(-1, 1)))
    shapes = [theirs["coefficients"], ours["coefficients"]]
    distances = numpy.abs(shapes[0] - shapes[1])
    # The correlation of a coefficient that hardly moves in this video means nothing.
    moving = [place for place in range(52) if min(of[:, place].std() for of in shapes) > 0.02]
    return {
        "frames": len(ours["landmarker"]),
        "landmarker_px": apart(theirs["landmarker"], ours["landmarker"]),
        "rotation_deg": {"mean": float(angles.mean()), "worst": float(angles.max())},
        "position_cm": apart(*(of["matrices"][:, :3, 3:].transpose(0, 2, 1) for of in (theirs, ours))),
        "coefficients": {"mean": float(distances.mean()), "worst": float(distances.max())},
        "correlations": {
            str(ours["names"][place]): float(numpy.corrcoef(shapes[0][:, place], shapes[1][:, place])[0, 1]) for place in moving
        },
    }


def agreement(args):
    """Returns how far the results of MediaPipe are from those of its stand-in and, if there is one, of a newer MediaPipe."""
    import numpy

    theirs, ours = saved_by(args, "FaceLandmarker"), saved_by(args, "facewire as FaceLandmarker")
    of_stand_in = {
        **of_landmarkers(theirs, ours),
        "mesh_px": apart(theirs["mesh"], ours["mesh"]),
        "their_landmarker_and_their_mesh_px": apart(theirs["landmarker"], theirs["mesh"]),
        "their_mesh_by_opencv_and_by_ffmpeg_px": apart(theirs["mesh"][::8], numpy.load(GOLDEN)[:, :, :2] / 32),
    }
    return {"agreement": of_stand_in, **({"newer_agreement": of_landmarkers(theirs, saved_by(args, NEWER))} if args.newer else {})}


def python_of(args, side):
    """Returns the Python of a side."""
    if side == NEWER:
        return args.newer
    return args.ours if side.startswith("facewire") else args.theirs


def start(args, side, *options):
    """Runs a side and returns what it prints."""
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "compare_python_side.py")
    command = [python_of(args, side), script, side.removeprefix("newer "), args.film, args.model or "", *options]
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if run.returncode:
        sys.exit(f"{side} failed:\n{run.stderr}")
    return run.stdout


def measure(args):
    """Runs all rounds and returns a list of the figures of each round for each side."""
    is_asked = {"FaceLandmarker": args.model, NEWER: args.newer}
    sides = [side for side in SIDES if is_asked.get(side, True)]
    sizes = {python: size_mb(python) for python in (args.theirs, args.newer, args.ours) if python}
    found = {}
    for number in range(args.rounds):
        print(f"round {number + 1} of {args.rounds}", file=sys.stderr)
        first = number % len(sides)
        for side in sides[first:] + sides[:first]:
            figures = json.loads(start(args, side).splitlines()[-1])
            found.setdefault(side, []).append({**figures, "size_mb": sizes[python_of(args, side)]})
    return {side: found[side] for side in sides}


def main():
    """Measures, and prints a table or JSON."""
    parser = argparse.ArgumentParser(description="Compares MediaPipe for Python with the wheel of facewire on one core.")
    parser.add_argument("--theirs", help="Python of an environment with MediaPipe")
    parser.add_argument("--newer", help="Python of an environment with a newer MediaPipe, whose FaceLandmarker is measured too")
    parser.add_argument("--ours", help="Python of an environment with the wheel")
    parser.add_argument("--film", help="pictures of 640 x 480 in red, green and blue, one after the other")
    parser.add_argument("--model", help="face_landmarker.task")
    parser.add_argument("--rounds", type=int, default=5, help="how often each side runs (default 5)")
    parser.add_argument("--json", action="store_true", help="print one object on one line")
    args = parser.parse_args()
    if args.newer and not args.model:
        parser.error("a newer MediaPipe has FaceLandmarker alone, which needs its model: give it with --model")
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    found = measure(args)
    table = {}
    for figure in FIGURES:
        table[figure] = {side: statistics.median(of[figure] for of in rounds) for side, rounds in found.items()}
        pairs = [("facewire", "FaceMesh"), ("facewire", "FaceLandmarker"), ("facewire", NEWER), (NEWER, "FaceLandmarker")]
        for one, other in (pair for pair in pairs if found.keys() >= set(pair)):
            ratios = [of_one[figure] / of_other[figure] for of_one, of_other in zip(found[one], found[other])]
            table[figure][f"{one} / {other}"] = [statistics.median(ratios), min(ratios), max(ratios)]
    near = agreement(args) if args.model else {"agreement": None}
    if args.json:
        print(json.dumps({"rounds": args.rounds, **table, **near}))
        return
    for figure, row in table.items():
        print(FIGURES[figure])
        for name, value in row.items():
            told = f"{value:.3f}" if isinstance(value, float) else "{:.2f} ({:.2f} to {:.2f})".format(*value)
            print(f"    {name:<44}{told}")
    if not args.model:
        print("FaceLandmarker was not measured: give its model with --model face_landmarker.task")
        return
    for name, of in near.items():
        print_agreement("its stand-in" if name == "agreement" else "a newer one", of)


def print_agreement(other, near):
    """Prints how far MediaPipe's results and those of another FaceLandmarker are apart."""
    print(f"MediaPipe and {other} in {near['frames']} pictures: distance in the mean, and the largest")
    for name, of in near.items():
        if isinstance(of, dict) and "mean" in of:
            print(f"    {name:<40}{of['mean']:.3f} {of['worst']:.3f}")
    order = sorted(near["correlations"].items(), key=lambda item: item[1])
    print(f"correlations of the {len(order)} coefficients that move, {statistics.median(near['correlations'].values()):.2f} in the median:")
    print("    " + ", ".join(f"{name} {correlation:.2f}" for name, correlation in order))


if __name__ == "__main__":
    main()
