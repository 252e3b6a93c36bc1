"""Measures MediaPipe's FaceMesh and facewire alternately on the same clip and one core, and prints times and ratios.

In each round every program runs once, in a process of its own. The order changes from round to round, so that changes of
the machine's speed affect all programs alike. Times count from a decoded picture in memory to the result of that frame
(MediaPipe: 478 landmarks; facewire: landmarks, 52 coefficients and head pose), and from the JPEG image of a camera to
the same result. For MediaPipe, OpenCV decodes the JPEG images. The figures are medians over the rounds. A ratio is the
median of the ratios of the rounds, given with the lowest and the highest of them.
"""

import argparse
import json
import os
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
import time

CLIP = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "src", "capture", "demo.avi")
QUANTILES = {"p50_ms": 0.5, "p95_ms": 0.95, "p99_ms": 0.99}
THEIRS, NATIVE, ONNX = "mediapipe", "facewire", "onnxruntime"
TITLES = {THEIRS: "MediaPipe", NATIVE: "facewire", ONNX: "ONNX Runtime"}


def quantiles(milliseconds):
    """Returns the quantiles of durations as a dictionary with the keys of QUANTILES."""
    ordered = sorted(milliseconds)
    return {name: ordered[min(len(ordered) - 1, round(part * len(ordered)))] for name, part in QUANTILES.items()}


def images(path):
    """Yields the JPEG images of a Motion-JPEG AVI file."""
    with open(path, "rb") as file:
        content = file.read()
    at = content.index(b"movi") + 4
    while content[at:at + 4] == b"00dc":
        (length,) = struct.unpack_from("<I", content, at + 4)
        yield content[at + 8:at + 8 + length]
        at += 8 + length + length % 2


def mediapipe_round():
    """Plays the clip twice, the first time to warm up, and prints the figures of the second pass as JSON.

    This runs in a child process, so that its peak memory is that of MediaPipe alone.
    """
    import cv2
    import mediapipe
    import numpy

    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    decoded, mjpeg = [], []
    for counted in (False, True):
        for image in images(CLIP):
            begun = time.perf_counter()
            picture = cv2.imdecode(numpy.frombuffer(image, numpy.uint8), cv2.IMREAD_COLOR)
            rgb = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
            in_memory = time.perf_counter()
            found = mesh.process(rgb)
            ended = time.perf_counter()
            if counted and found.multi_face_landmarks:
                decoded.append(1000 * (ended - in_memory))
                mjpeg.append(1000 * (ended - begun))
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"decoded": quantiles(decoded), "mjpeg": quantiles(mjpeg), "memory_mb": memory_mb}))


def last_json(command):
    """Runs a command and returns the JSON value on the last line of its output."""
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if run.returncode != 0:
        sys.exit(f"{command[0]} failed:\n{run.stderr}")
    return json.loads(run.stdout.splitlines()[-1])


def facewire_round(program, settings, *options):
    """Plays the clip once with facewire, after one pass to warm up, and returns the figures."""
    bench = last_json([program, "bench", "demo", "--rounds", "1", "--json", "--config", settings, *options])
    return {
        "decoded": {name: bench["whole"][name] for name in QUANTILES},
        "mjpeg": {name: bench["decode_and_whole"][name] for name in QUANTILES},
        "memory_mb": bench["peak_memory_mb"],
        "machine": bench["machine"],
        "layers": bench.get("layers"),
    }


def measure(program, rounds):
    """Runs all rounds and returns a list of the figures of each round for each program."""
    found = {side: [] for side in TITLES}
    with tempfile.TemporaryDirectory() as folder:
        settings = {}
        for side, engine in ((NATIVE, "native"), (ONNX, "onnxruntime")):
            settings[side] = os.path.join(folder, f"{engine}.toml")
            with open(settings[side], "w", encoding="utf-8") as file:
                file.write(f'[networks]\nengine = "{engine}"\nthreads = 1\n')
        run = {
            THEIRS: lambda: last_json([sys.executable, os.path.abspath(__file__), "--mediapipe-round"]),
            NATIVE: lambda: facewire_round(program, settings[NATIVE], "--layers"),
            ONNX: lambda: facewire_round(program, settings[ONNX]),
        }
        sides = list(run)
        for number in range(rounds):
            print(f"round {number + 1} of {rounds}", file=sys.stderr)
            for side in sides[number % 3:] + sides[:number % 3]:
                found[side].append(run[side]())
    return found


def row_of(found, figure):
    """Returns the medians of one figure and its ratios to MediaPipe's. `figure` selects it from the figures of a round."""
    values = {side: [figure(of_round) for of_round in rounds] for side, rounds in found.items()}
    row = {side: round(statistics.median(of_side), 3) for side, of_side in values.items()}
    for side, prefix in ((NATIVE, ""), (ONNX, f"{ONNX}_")):
        ratios = [ours / theirs for ours, theirs in zip(values[side], values[THEIRS])]
        row[f"{prefix}ratio"] = round(statistics.median(ratios), 3)
        row[f"{prefix}ratio_range"] = [round(min(ratios), 3), round(max(ratios), 3)]
    return row


def table_of(found):
    """Returns all figures. Those of decoded pictures stay at the top level, where readers of `--json` expect them."""

    def rows(kind):
        return {name: row_of(found, lambda of_round: of_round[kind][name]) for name in QUANTILES}

    shares = [of_round["layers"]["frame"]["percent_of_peak"] for of_round in found[NATIVE]]
    return {
        **rows("decoded"),
        "memory_mb": row_of(found, lambda of_round: of_round["memory_mb"]),
        "mjpeg": rows("mjpeg"),
        "networks_percent_of_peak": {
            "facewire": round(statistics.median(shares), 1),
            "range": [round(min(shares), 1), round(max(shares), 1)],
            "peak_g_per_s": round(max(of_round["layers"]["peak_g_per_s"] for of_round in found[NATIVE]), 1),
            "kernels": found[NATIVE][0]["layers"]["kernels"],
        },
    }


def print_rows(title, rows):
    """Prints a table with a line for each figure."""

    def spread(row, prefix):
        return "{:.2f} ({:.2f} to {:.2f})".format(row[f"{prefix}ratio"], *row[f"{prefix}ratio_range"])

    print(f"{title:<12}" + "".join(f"{TITLES[side]:>14}" for side in TITLES)
          + f"{'facewire / MediaPipe':>26}{'ONNX Runtime / MediaPipe':>28}")
    for name, row in rows.items():
        print(f"{name:<12}" + "".join(f"{row[side]:14.2f}" for side in TITLES)
              + f"{spread(row, ''):>26}{spread(row, f'{ONNX}_'):>28}")
    print()


def main():
    """Measures, and prints a table or JSON."""
    parser = argparse.ArgumentParser(description="Compares facewire with MediaPipe's FaceMesh on one core.")
    parser.add_argument("--facewire", help="path of the program facewire, built in release mode")
    parser.add_argument("--rounds", type=int, default=7, help="how often each program runs (default 7)")
    parser.add_argument("--json", action="store_true", help="print one object on one line")
    parser.add_argument("--mediapipe-round", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.mediapipe_round:
        return mediapipe_round()

    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    found = measure(args.facewire, args.rounds)
    table, machine = table_of(found), found[NATIVE][0]["machine"]
    if args.json:
        print(json.dumps({"machine": machine, "rounds": args.rounds, **table}))
        return
    print(f"on core {core} of {machine}, medians of {args.rounds} rounds, ratios with their lowest and highest\n")
    print_rows("decoded", {name: table[name] for name in (*QUANTILES, "memory_mb")})
    print_rows("from MJPEG", table["mjpeg"])
    share = table["networks_percent_of_peak"]
    print("facewire's networks run at {:.0f} % ({:.0f} to {:.0f}) of the {} multiply-adds".format(
        share["facewire"], *share["range"], f"{share['peak_g_per_s']} G")
        + f" a second that this core reaches with {share['kernels']}")


if __name__ == "__main__":
    main()
