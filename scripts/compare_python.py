"""Measures MediaPipe for Python and the wheel of facewire alternately on the same pictures and one core.

In each round every side runs once, in a process of its own; the order changes from round to round. Pictures lie decoded in a
file, from which each is read into one array before the clock starts. The figures are medians over the rounds, ratios are the
medians of the ratios of the rounds, with the lowest and the highest of them.

FaceLandmarker needs its model, which is in no Python package: give the file face_landmarker.task with --model.
"""

import argparse
import json
import os
import pathlib
import resource
import statistics
import subprocess
import sys
import time

BYTES = 640 * 480 * 3
FIGURES = {"p50_ms": "ms, p50", "p95_ms": "ms, p95", "first_s": "s from import to first result", "memory_mb": "MB of memory", "size_mb": "MB on disk"}


def face_mesh(_):
    """Returns MediaPipe's FaceMesh as a function from a picture and its number to whether there is a face."""
    import mediapipe

    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    return lambda picture, _: mesh.process(picture).multi_face_landmarks


def face_landmarker(model):
    """Returns MediaPipe's FaceLandmarker with blendshapes."""
    import mediapipe

    vision = mediapipe.tasks.vision
    options = vision.FaceLandmarkerOptions(
        base_options=mediapipe.tasks.BaseOptions(model_asset_path=model),
        running_mode=vision.RunningMode.VIDEO,
        output_face_blendshapes=True,
    )
    landmarker = vision.FaceLandmarker.create_from_options(options)

    def find(picture, number):
        image = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=picture)
        return landmarker.detect_for_video(image, 33 * number).face_blendshapes

    return find


def facewire(_):
    """Returns facewire's tracker."""
    import facewire as ours

    tracker = ours.FaceTracker()
    return lambda picture, number: tracker.process(picture, number / 30, format="rgb")


def stand_in(_):
    """Returns what stands in for FaceMesh."""
    import facewire.mediapipe_compat as ours

    mesh = ours.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    return lambda picture, _: mesh.process(picture).multi_face_landmarks


SIDES = {"FaceMesh": face_mesh, "FaceLandmarker": face_landmarker, "facewire": facewire, "facewire as FaceMesh": stand_in}


def run_side(side, film, model):
    """Plays the pictures twice, the first time to warm up, and prints the figures as JSON."""
    import numpy

    picture, milliseconds, number = numpy.zeros((480, 640, 3), numpy.uint8), [], 0
    with open(film, "rb", buffering=0) as file:
        file.readinto(picture)
        begun = time.perf_counter()
        find = SIDES[side](model)
        assert find(picture, number)
        first_s = time.perf_counter() - begun
        for is_counted in (False, True):
            file.seek(0)
            while file.readinto(picture) == BYTES:
                number += 1
                begun = time.perf_counter()
                is_found = find(picture, number)
                if is_counted and is_found:
                    milliseconds.append(1000 * (time.perf_counter() - begun))
    milliseconds.sort()
    print(json.dumps({
        "p50_ms": milliseconds[len(milliseconds) // 2],
        "p95_ms": milliseconds[len(milliseconds) * 95 // 100],
        "first_s": first_s,
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "frames": len(milliseconds),
    }))


def size_mb(python):
    """Returns the size of the packages that an environment has besides pip."""
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    folder = pathlib.Path(subprocess.run([python, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout.strip())
    tools = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    files = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sum(path.stat().st_size for path in files if not path.relative_to(folder).parts[0].startswith(tools)) / 1e6


def measure(args):
    """Runs all rounds and returns a list of the figures of each round for each side."""
    sides = [side for side in SIDES if side != "FaceLandmarker" or args.model]
    pythons = {side: args.theirs if side in ("FaceMesh", "FaceLandmarker") else args.ours for side in sides}
    sizes, found = {python: size_mb(python) for python in set(pythons.values())}, {side: [] for side in sides}
    for number in range(args.rounds):
        print(f"round {number + 1} of {args.rounds}", file=sys.stderr)
        start = number % len(sides)
        for side in sides[start:] + sides[:start]:
            command = [pythons[side], os.path.abspath(__file__), "--side", side, "--film", args.film, *(["--model", args.model] if args.model else [])]
            run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            if run.returncode:
                sys.exit(f"{side} failed:\n{run.stderr}")
            found[side].append({**json.loads(run.stdout.splitlines()[-1]), "size_mb": sizes[pythons[side]]})
    return found


def main():
    """Measures, and prints a table or JSON."""
    parser = argparse.ArgumentParser(description="Compares MediaPipe for Python with the wheel of facewire on one core.")
    parser.add_argument("--theirs", help="Python of an environment with MediaPipe")
    parser.add_argument("--ours", help="Python of an environment with the wheel")
    parser.add_argument("--film", help="pictures of 640 x 480 in red, green and blue, one after the other")
    parser.add_argument("--model", help="face_landmarker.task")
    parser.add_argument("--rounds", type=int, default=5, help="how often each side runs (default 5)")
    parser.add_argument("--json", action="store_true", help="print one object on one line")
    parser.add_argument("--side", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.side:
        return run_side(args.side, args.film, args.model)
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
    if args.json:
        print(json.dumps({"rounds": args.rounds, **table}))
        return
    for figure, row in table.items():
        print(FIGURES[figure])
        for name, value in row.items():
            told = f"{value:.3f}" if isinstance(value, float) else "{:.2f} ({:.2f} to {:.2f})".format(*value)
            print(f"    {name:<28}{told}")
    if "FaceLandmarker" not in found:
        print("FaceLandmarker was not measured: give its model with --model face_landmarker.task")


if __name__ == "__main__":
    main()
