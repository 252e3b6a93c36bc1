"""Measures facewire and MediaPipe's FaceMesh in turns on the same clip, and prints both with their ratios.

Each program runs once a round in a process of its own, so that drifts of the machine's speed affect both. Both are timed
from a decoded picture in memory to the result of that frame (MediaPipe: 478 landmarks; facewire: landmarks, 52
coefficients and head pose). The figures are medians over the rounds.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time

CLIP = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "src", "capture", "demo.avi")
FIGURES = ("p50_ms", "p95_ms", "p99_ms", "memory_mb")


def quantile(ordered, part):
    return ordered[min(len(ordered) - 1, round(part * len(ordered)))]


def mediapipe_round():
    """Prints the figures of one pass over the clip, after a warm-up pass, as JSON. Runs in a child process."""
    import cv2
    import mediapipe

    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    milliseconds = []
    for counted in (False, True):
        film = cv2.VideoCapture(CLIP)
        while True:
            there, picture = film.read()
            if not there:
                break
            rgb = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
            begun = time.perf_counter()
            mesh.process(rgb)
            if counted:
                milliseconds.append(1000 * (time.perf_counter() - begun))
    milliseconds.sort()
    figures = {f"p{round(100 * part)}_ms": quantile(milliseconds, part) for part in (0.5, 0.95, 0.99)}
    figures["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(figures))


def last_json(command):
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if run.returncode != 0:
        sys.exit(f"{command[0]} failed:\n{run.stderr}")
    return json.loads(run.stdout.splitlines()[-1])


def facewire_round(program):
    bench = last_json([program, "bench", "demo", "--rounds", "1", "--json"])
    figures = {name: bench["whole"][name] for name in FIGURES if name != "memory_mb"}
    return figures | {"memory_mb": bench["peak_memory_mb"]}, bench["machine"]


def main():
    parser = argparse.ArgumentParser(description="facewire beside MediaPipe's FaceMesh, in one run")
    parser.add_argument("--facewire", help="the program")
    parser.add_argument("--rounds", type=int, default=7, help="how often each program runs (default 7)")
    parser.add_argument("--json", action="store_true", help="print one object on one line")
    parser.add_argument("--mediapipe-round", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.mediapipe_round:
        return mediapipe_round()

    theirs, ours, machine = [], [], ""
    for number in range(args.rounds):
        print(f"round {number + 1} of {args.rounds}", file=sys.stderr)
        theirs.append(last_json([sys.executable, os.path.abspath(__file__), "--mediapipe-round"]))
        figures, machine = facewire_round(args.facewire)
        ours.append(figures)
    median = lambda rounds, name: statistics.median(figures[name] for figures in rounds)
    table = {
        name: {"mediapipe": round(median(theirs, name), 3), "facewire": round(median(ours, name), 3)}
        for name in FIGURES
    }
    for name, row in table.items():
        pairs = [mine[name] / other[name] for mine, other in zip(ours, theirs)]
        row["ratio"] = round(statistics.median(pairs), 3)
    if args.json:
        print(json.dumps({"machine": machine, "rounds": args.rounds, **table}))
        return
    print(f"on {machine}, medians of {args.rounds} rounds\n")
    print(f"{'':<12}{'MediaPipe':>12}{'facewire':>12}{'ratio':>9}")
    for name, row in table.items():
        print(f"{name:<12}{row['mediapipe']:>12.2f}{row['facewire']:>12.2f}{row['ratio']:>9.2f}")


if __name__ == "__main__":
    main()
