"""Measures MediaPipe for Python and the wheel of facewire alternately on the same pictures and one core.

In each round every side runs once, in a process of its own; the order changes from round to round. Pictures lie decoded in a
file, from which each is read into one array before the clock starts. The figures are medians over the rounds, ratios are the
medians of the ratios of the rounds, with the lowest and the highest of them.

FaceLandmarker needs its model, which MediaPipe's package does not contain: give the file face_landmarker.task with --model. Then
its results are compared, too, with those of the stand-in for FaceLandmarker in the same pictures.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

FIGURES = {"p50_ms": "ms, p50", "p95_ms": "ms, p95", "first_s": "s from import to first result", "memory_mb": "MB of memory",
           "before_mb": "MB of them before the import: Python, NumPy, a picture", "size_mb": "MB on disk"}
# MediaPipe's own landmarks of every 8th picture as FFmpeg decodes it, in 32nds of a pixel.
GOLDEN = pathlib.Path(__file__).resolve().parent.parent / "tests" / "golden" / "demo-landmarks.npy"
SIDES = ("FaceMesh", "FaceLandmarker", "facewire", "facewire as FaceMesh", "facewire as FaceLandmarker")


def size_mb(python):
    """Returns the size of the packages that an environment has besides pip."""
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    folder = pathlib.Path(subprocess.run([python, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout.strip())
    tools = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    files = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sum(path.stat().st_size for path in files if not path.relative_to(folder).parts[0].startswith(tools)) / 1e6


def agreement(args):
    """Returns how far the results of MediaPipe and of its stand-in are apart in the same pictures."""
    import numpy

    both = []
    with tempfile.TemporaryDirectory() as folder:
        for side in ("FaceLandmarker", "facewire as FaceLandmarker"):
            path = os.path.join(folder, "saved.npz")
            start(args, side, path)
            with numpy.load(path) as saved:
                both.append(dict(saved))
    theirs, ours = both

    def apart(points, others):
        distances = numpy.linalg.norm(points - others, axis=2)
        return {"mean": float(distances.mean()), "worst": float(distances.max())}

    turns = numpy.einsum("nij,nij->n", theirs["matrices"][:, :3, :3], ours["matrices"][:, :3, :3])
    angles = numpy.degrees(numpy.arccos(((turns - 1) / 2).clip(-1, 1)))
    # A coefficient that hardly moves in this film has no correlation that says anything.
    shapes = [theirs["coefficients"], ours["coefficients"]]
    moving = [place for place in range(52) if min(of[:, place].std() for of in shapes) > 0.02]
    return {
        "frames": len(ours["mesh"]),
        "mesh_px": apart(theirs["mesh"], ours["mesh"]),
        "landmarker_px": apart(theirs["landmarker"], ours["landmarker"]),
        "their_landmarker_and_their_mesh_px": apart(theirs["landmarker"], theirs["mesh"]),
        "their_mesh_by_opencv_and_by_ffmpeg_px": apart(theirs["mesh"][::8], numpy.load(GOLDEN)[:, :, :2] / 32),
        "rotation_deg": {"mean": float(angles.mean()), "worst": float(angles.max())},
        "position_cm": apart(*(of["matrices"][:, :3, 3:].transpose(0, 2, 1) for of in both)),
        "correlations": {
            str(ours["names"][place]): float(numpy.corrcoef(shapes[0][:, place], shapes[1][:, place])[0, 1]) for place in moving
        },
    }


def is_theirs(side):
    """Whether this side is MediaPipe."""
    return not side.startswith("facewire")


def start(args, side, *options):
    """Runs a side and returns what it prints."""
    python = args.theirs if is_theirs(side) else args.ours
    command = [python, os.path.join(os.path.dirname(os.path.abspath(__file__)), "compare_python_side.py"), side, args.film, args.model or "", *options]
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if run.returncode:
        sys.exit(f"{side} failed:\n{run.stderr}")
    return run.stdout


def measure(args):
    """Runs all rounds and returns a list of the figures of each round for each side."""
    sides = [side for side in SIDES if side != "FaceLandmarker" or args.model]
    sizes, found = {True: size_mb(args.theirs), False: size_mb(args.ours)}, {}
    for number in range(args.rounds):
        print(f"round {number + 1} of {args.rounds}", file=sys.stderr)
        first = number % len(sides)
        for side in sides[first:] + sides[:first]:
            figures = json.loads(start(args, side).splitlines()[-1])
            found.setdefault(side, []).append({**figures, "size_mb": sizes[is_theirs(side)]})
    return {side: found[side] for side in sides}


def main():
    """Measures, and prints a table or JSON."""
    parser = argparse.ArgumentParser(description="Compares MediaPipe for Python with the wheel of facewire on one core.")
    parser.add_argument("--theirs", help="Python of an environment with MediaPipe")
    parser.add_argument("--ours", help="Python of an environment with the wheel")
    parser.add_argument("--film", help="pictures of 640 x 480 in red, green and blue, one after the other")
    parser.add_argument("--model", help="face_landmarker.task")
    parser.add_argument("--rounds", type=int, default=5, help="how often each side runs (default 5)")
    parser.add_argument("--json", action="store_true", help="print one object on one line")
    args = parser.parse_args()
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    found = measure(args)
    table = {}
    for figure in FIGURES:
        table[figure] = {side: statistics.median(of[figure] for of in rounds) for side, rounds in found.items()}
        for theirs in ("FaceMesh", "FaceLandmarker"):
            if theirs in found:
                ratios = [ours[figure] / other[figure] for ours, other in zip(found["facewire"], found[theirs])]
                table[figure][f"facewire / {theirs}"] = [statistics.median(ratios), min(ratios), max(ratios)]
    near = agreement(args) if args.model else None
    if args.json:
        print(json.dumps({"rounds": args.rounds, **table, "agreement": near}))
        return
    for figure, row in table.items():
        print(FIGURES[figure])
        for name, value in row.items():
            told = f"{value:.3f}" if isinstance(value, float) else "{:.2f} ({:.2f} to {:.2f})".format(*value)
            print(f"    {name:<28}{told}")
    if near:
        print(f"MediaPipe and its stand-in in {near['frames']} pictures: distance in the mean, and the largest")
        for name, of in near.items():
            if isinstance(of, dict) and "mean" in of:
                print(f"    {name:<40}{of['mean']:.2f} {of['worst']:.2f}")
        order = sorted(near["correlations"].items(), key=lambda item: item[1])
        print(f"correlations of the {len(order)} coefficients that move, {statistics.median(near['correlations'].values()):.2f} in the median:")
        print("    " + ", ".join(f"{name} {correlation:.2f}" for name, correlation in order))
    else:
        print("FaceLandmarker was not measured: give its model with --model face_landmarker.task")


if __name__ == "__main__":
    main()
