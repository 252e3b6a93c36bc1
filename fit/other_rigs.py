#!/usr/bin/env python3
"""Judges the coefficients on heads of other artists, which another renderer draws.

Each head is a .glb file with morph targets named as ARKit's blendshapes. `render` draws it by three.js in Chromium, as a webcam
would see it: 640 x 480 at 30 frames a second, 60 degrees across, eyes about 105 pixels apart, the head swaying by 12 degrees.
It rests for 30 frames. Then each blendshape rises and falls by itself, but both eyes look the same way, and mouthClose goes
with jawOpen. The 80 frames of each recording in which most moves follow, and then emotions and other combinations.
NAME-LIGHT.avi is the video, and NAME-LIGHT.csv has the true coefficients, which `facewire-fit evaluate` reads, too.

`judge` runs `facewire track` on these videos, with the neutral face from the 30 frames (known), with `--neutral auto`, and with
`--neutral auto` on the third showing of the video (watched). It prints for each video

    r      Pearson's correlation, mean over the coefficients that move (standard deviation of the truth above 0.02)
    MSE    mean squared error, mean over 51 coefficients (all but tongueOut)
    slope  of the estimate over the truth, mean over those that move

and then the same for each coefficient, the means over the videos. A frame without a face counts
as a face at rest, and their number is printed.

One artist's smile of 1 is larger than another's: compare r, and slopes with those of another tracker on the same videos. The
mean squared error contains the difference of the artists' amplitudes. MediaPipe learns no neutral face, so
compare it with `auto`.

    npm pack three@0.187.0 && tar xzf three-0.187.0.tgz
    pip install numpy mediapipe==0.10.14
    fit/other_rigs.py render rigs/ facecap.glb bob.glb --three package/ --lights front
    fit/other_rigs.py judge rigs/*.avi --mediapipe face_landmarker.task
    fit/other_rigs.py judge rigs/*.avi --model new.toml

MediaPipe's curves stay beside the videos, so that later runs need neither the option nor the package. Set FACEWIRE to the
program if it is not in the path. `render` needs chromium, ffmpeg and Mesa.
"""

import argparse
import contextlib
import csv
import functools
import http.server
import json
import math
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading

import numpy as np

PAGE = pathlib.Path(__file__).with_suffix(".html")
CHROMIUM = ("chromium --headless --no-sandbox --no-first-run --disable-dev-shm-usage --disable-background-networking "
            "--remote-debugging-port=0 --disable-gpu-compositing --ignore-gpu-blocklist "
            "--use-gl=angle --use-angle=gl-egl").split()
# Mesa's llvmpipe draws by the processor, much faster than Chromium's own SwiftShader.
BY_PROCESSOR = {"LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe", "EGL_PLATFORM": "surfaceless"}
LIGHTS = ("front", "side", "screen")
SIZE, FPS = (640, 480), 30
PATIENCE_S = 120
SINGLE = ("jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft mouthRight mouthRollLower "
          "mouthRollUpper mouthShrugLower mouthShrugUpper cheekPuff browInnerUp").split()
PAIRS = ("eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint eyeWide mouthSmile mouthFrown mouthDimple "
         "mouthStretch mouthPress mouthLowerDown mouthUpperUp browDown browOuterUp cheekSquint noseSneer").split()
NAMES = [*SINGLE, *(pair + side for pair in PAIRS for side in ("Left", "Right"))]
EYES_TURN = (("OutLeft", "InRight"), ("InLeft", "OutRight"), ("UpLeft", "UpRight"), ("DownLeft", "DownRight"))
# Both sides move if a name has none.
COMBINED = (
    dict(browInnerUp=0.8, browDown=0.5, mouthFrown=0.3),
    dict(mouthSmile=0.8, cheekSquint=0.6, eyeSquint=0.4),
    dict(mouthSmile=0.9, cheekSquint=0.7, jawOpen=0.4, mouthUpperUp=0.4),
    dict(noseSneer=0.8, mouthUpperUp=0.5, browDown=0.4, eyeSquint=0.3),
    dict(mouthRollLower=0.8, mouthRollUpper=0.8),
    dict(mouthPucker=0.9),
    dict(mouthFunnel=0.7, jawOpen=0.3),
    dict(browInnerUp=0.8, browOuterUp=0.8, eyeWide=0.7, jawOpen=0.5),
    dict(browDown=0.9, eyeSquint=0.4, mouthPress=0.6, noseSneer=0.3),
    dict(browInnerUp=0.7, mouthFrown=0.8, mouthShrugLower=0.5),
    dict(browInnerUp=0.7, browOuterUp=0.4, eyeWide=0.8, mouthStretch=0.6, jawOpen=0.2),
    dict(mouthSmileLeft=0.6, mouthDimpleLeft=0.5),
    dict(eyeBlinkRight=1.0, cheekSquintRight=0.6, mouthSmileRight=0.4),
    dict(browOuterUpRight=0.8, browDownLeft=0.6, mouthLeft=0.5),
    dict(mouthLowerDown=0.8, mouthStretch=0.4, jawOpen=0.2),
    dict(cheekPuff=0.9, mouthPress=0.3),
)
REST_FRAMES, SINGLE_FRAMES, RECORDED_FRAMES, COMBINED_FRAMES = 30, 12, 80, 18
LEAST_DEVIATION = 0.02


# --- what the head does ---


def movement(peaks, frames):
    """Returns coefficients that rise to their peaks and fall again."""
    values = np.zeros((frames, len(NAMES)))
    course = (1 - np.cos(2 * np.pi * (np.arange(frames) + 0.5) / frames)) / 2
    for name, peak in peaks.items():
        for column in (name,) if name in NAMES else (name + "Left", name + "Right"):
            values[:, NAMES.index(column)] = peak * course
    return values


def alone():
    """Returns the peaks of what moves by itself. Lips that close over a shut jaw would go through each other."""
    peaks = [{name: 1} for name in NAMES if not name.startswith(("eyeLook", "mouthClose"))]
    gaze = [{f"eyeLook{direction}": 1 for direction in directions} for directions in EYES_TURN]
    return [*peaks, {"mouthClose": 1, "jawOpen": 1}, *gaze]


def recorded(path):
    """Returns the frames of a recording in which most moves."""
    curves = read(path)
    values = np.stack([curves[name.lower()] for name in NAMES], 1).clip(0, 1)
    moves = np.convolve(np.abs(np.diff(values, axis=0)).sum(1), np.ones(RECORDED_FRAMES - 1), "valid")
    first = int(moves.argmax())
    return values[first : first + RECORDED_FRAMES]


def sequence(curves):
    """Returns the coefficients of all frames, and yaw, pitch, roll in degrees and the place of the camera."""
    parts = [movement({}, REST_FRAMES)]
    parts += [movement(peaks, SINGLE_FRAMES) for peaks in alone()]
    parts += [recorded(path) for path in curves]
    parts += [movement(peaks, COMBINED_FRAMES) for peaks in COMBINED]
    values = np.concatenate(parts)
    seconds = np.arange(len(values)) / FPS
    begun = np.clip(seconds - REST_FRAMES / FPS, 0, 1)
    sways = ((12, 7.1), (7, 5.3), (5, 9.7), (0.3, 6.1), (0.15, 8.3), (0.1, 11.9))
    pose = np.stack([begun * size * np.sin(2 * np.pi * seconds / period) for size, period in sways], 1)
    pose[:, 5] += 1
    return values, pose


# --- rendering ---


class Studio(http.server.BaseHTTPRequestHandler):
    """Serves the page, and passes the pictures that it sends on to FFmpeg."""

    def __init__(self, files, sink, end, *args):
        self.files, self.sink, self.end = files, sink, end
        super().__init__(*args)

    def log_message(self, *_):
        """Logs nothing."""

    def answer(self, body, kind):
        """Sends an answer."""
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_GET(self):
        """Serves a file."""
        path = self.path.split("?")[0]
        if path.startswith("/three/"):
            three = self.files["/three/"].resolve()
            file = (three / path.removeprefix("/three/")).resolve()
            if not file.is_relative_to(three) or not file.is_file():
                return self.send_error(404)
            return self.answer(file.read_bytes(), "text/javascript")
        if path not in self.files:
            return self.send_error(404)
        return self.answer(self.files[path], "text/html" if path == "/" else "application/octet-stream")

    def do_POST(self):
        """Takes a picture or the page's last word."""
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path == "/frame":
            self.sink.write(body)
        elif self.path == "/missing" and body:
            print(f"    not in this head: {body.decode()}", file=sys.stderr)
        elif self.path == "/end":
            self.end.append(body.decode())
        self.server.latest.set()
        self.answer(b"", "text/plain")


def render(head, light, three, values, pose, video):
    """Draws all frames of one head into a video."""
    frames = [{"values": value.round(4).tolist(), "pose": place.round(4).tolist()} for value, place in zip(values, pose)]
    files = {
        "/": PAGE.read_bytes(),
        "/head.glb": head.read_bytes(),
        "/sequence": json.dumps({"names": NAMES, "frames": frames, "light": light}).encode(),
        "/three/": three,
    }
    unfinished = video.with_suffix(".part")
    ffmpeg = f"ffmpeg -v error -y -f image2pipe -c:v mjpeg -framerate {FPS} -i - -c copy".split()
    writer = subprocess.Popen([*ffmpeg, "-f", "avi", unfinished], stdin=subprocess.PIPE)
    end = []
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Studio, files, writer.stdin, end))
    server.latest = threading.Event()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        page = f"http://127.0.0.1:{server.server_port}/"
        command = [*CHROMIUM, f"--user-data-dir={folder}", page]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        browser = subprocess.Popen(command, env={**os.environ, **BY_PROCESSOR}, **quiet)
        try:
            while not end:
                if not server.latest.wait(PATIENCE_S):
                    end.append(f"Chromium sent nothing for {PATIENCE_S} s")
                server.latest.clear()
        finally:
            browser.kill()
            browser.wait()
            server.shutdown()
            server.server_close()
            with contextlib.suppress(BrokenPipeError):
                writer.stdin.close()
            failed = writer.wait()
    if failed or end[0]:
        raise SystemExit(f"{head}: {end[0] or 'FFmpeg failed'}")
    unfinished.rename(video)


def render_all(arguments):
    """Renders each head in each light."""
    curves = sorted(arguments.curves.glob("*.csv"))
    if not curves:
        raise SystemExit(f"{arguments.curves} has no recordings (*.csv)")
    if not (arguments.three / "build/three.module.js").is_file():
        raise SystemExit(f"{arguments.three} is not the package three, unpacked")
    # An end by a signal leaves no browser behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by a signal"))
    values, pose = sequence(curves)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for head in arguments.heads:
        for light in arguments.lights:
            video = arguments.folder / f"{head.stem}-{light}.avi"
            print(f"{video}: {len(values)} frames", file=sys.stderr)
            curves_of_mediapipe(video).unlink(missing_ok=True)
            table = [[index, *row] for index, row in enumerate(values.round(4).tolist())]
            write(video.with_suffix(".csv"), ["frame", *NAMES], table)
            render(head, light, arguments.three, values, pose, video)


# --- judging ---


def write(path, header, rows):
    """Writes a table."""
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def read(path):
    """Returns the columns of a table by their names in lower case. They are 0 in frames without a face, in which values are missing
    or the state is not live."""
    with open(path, newline="") as file:
        rows = [{name.lower(): value for name, value in row.items()} for row in csv.DictReader(file)]
    names = [name.lower() for name in NAMES]
    seen = np.array([row.get("state", "live") == "live" and row["jawopen"] != "" for row in rows])
    if not seen.all():
        print(f"{path}: no face in {np.count_nonzero(~seen)} of {len(rows)} frames", file=sys.stderr)
    return {name: np.nan_to_num([float(row[name] or 0) for row in rows]) * seen for name in names}


def track(video, *options):
    """Returns the curves of one video by `facewire track`."""
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/curves.csv"
        command = [os.environ.get("FACEWIRE", "facewire"), "track", video, *options, "--out", out]
        ended = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        if ended.returncode:
            raise SystemExit(f"{video}: {ended.stderr.strip()}")
        return read(out)


def track_again(video, *options):
    """Returns the curves of one video that has been shown twice before."""
    with tempfile.TemporaryDirectory() as folder:
        shown = f"{folder}/shown.avi"
        subprocess.run(["ffmpeg", "-v", "error", "-nostdin", "-stream_loop", "2", "-i", video, "-c", "copy", shown], check=True)
        curves = track(shown, *options)
    if any(len(curve) % 3 for curve in curves.values()):
        raise SystemExit(f"{video}: a frame was lost when the video was shown three times")
    return {name: curve[-(len(curve) // 3):] for name, curve in curves.items()}


def by_mediapipe(video, model):
    """Returns the curves of one video by MediaPipe, and keeps them beside the video."""
    path = curves_of_mediapipe(video)
    if model:
        write(path, ["frame", *NAMES], list(mediapipe_rows(video, model)))
    return read(path) if path.exists() else None


def curves_of_mediapipe(video):
    """Returns the path of MediaPipe's curves of a video."""
    return video.with_name(f"{video.stem}.mediapipe.csv")


def mediapipe_rows(video, model):
    """Yields MediaPipe's coefficients of each frame; they are empty if it finds no face."""
    import mediapipe

    vision = mediapipe.tasks.vision
    options = vision.FaceLandmarkerOptions(
        base_options=mediapipe.tasks.BaseOptions(model_asset_path=str(model)),
        running_mode=vision.RunningMode.VIDEO,
        output_face_blendshapes=True,
    )
    command = ["ffmpeg", "-v", "error", "-i", video, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    with vision.FaceLandmarker.create_from_options(options) as landmarker, \
            subprocess.Popen(command, stdout=subprocess.PIPE) as ffmpeg:
        index = 0
        while picture := ffmpeg.stdout.read(SIZE[0] * SIZE[1] * 3):
            pixels = np.frombuffer(picture, np.uint8).reshape(SIZE[1], SIZE[0], 3)
            image = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=pixels)
            found = landmarker.detect_for_video(image, index * 1000 // FPS).face_blendshapes
            scores = {shape.category_name: shape.score for shape in found[0]} if found else {}
            yield [index, *(f"{scores[name]:.5f}" if scores else "" for name in NAMES)]
            index += 1


def figures(found, truth):
    """Returns r, mean squared error and slope of each coefficient; r and slope are not-a-number where the truth rests."""
    rows = []
    for name in NAMES:
        one, other = found[name.lower()], truth[name.lower()]
        if len(one) != len(other):
            raise SystemExit(f"{len(one)} frames were tracked, but the truth has {len(other)}")
        spread, moves = other.std(), other.std() > LEAST_DEVIATION
        product = np.mean((one - one.mean()) * (other - other.mean()))
        r = product / max(one.std() * spread, 1e-9) if moves else math.nan
        rows.append((r, np.mean((one - other) ** 2), product / spread**2 if moves else math.nan))
    return np.array(rows)


def cells(trackers):
    """Returns the cells of one row of a table, three for each tracker."""
    return [f"{value:.{digits}f}" for row in trackers for value, digits in zip(row, (2, 4, 2))]


def print_table(first, heads, rows):
    """Prints a table."""
    print("\n| " + " | ".join([first, *(f"{head} {figure}" for head in heads for figure in ("r", "MSE", "slope"))]) + " |")
    print("|---|" + "---:|" * 3 * len(heads))
    for name, trackers in rows:
        print("| " + " | ".join([name, *cells(trackers)]) + " |")


def judge_all(arguments):
    """Prints the figures of each video, their means, and those of each coefficient."""
    options = ["--model", arguments.model] if arguments.model else []
    heads, all_rows = None, []
    for video in arguments.videos:
        truth = read(video.with_suffix(".csv"))
        neutral = {"known": f"0..{REST_FRAMES}", "auto": "auto"}
        found = {name: track(video, "--neutral", option, *options) for name, option in neutral.items()}
        found["watched"] = track_again(video, "--neutral", "auto", *options)
        theirs = by_mediapipe(video, arguments.mediapipe)
        if theirs:
            found["MediaPipe"] = theirs
        if heads not in (None, [*found]):
            raise SystemExit(f"{video} lacks MediaPipe's curves, which other videos have: give --mediapipe")
        heads = [*found]
        all_rows.append([figures(curves, truth) for curves in found.values()])
    rows = np.array(all_rows)
    each = np.nanmean(rows, axis=2)
    of_videos = [(video.stem, row) for video, row in zip(arguments.videos, each)]
    print_table("video", heads, [*of_videos, ("**mean of the videos**", each.mean(0))])
    means = np.nanmean(rows, axis=0)
    order = range(len(NAMES))
    if "MediaPipe" in heads:
        # Those in which MediaPipe is ahead come first.
        order = sorted(order, key=lambda place: means[0, place, 0] - means[-1, place, 0])
    print_table("coefficient", heads, [(NAMES[place], means[:, place]) for place in order])


def main():
    """Renders or judges."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    of_render = commands.add_parser("render", help="draw heads into videos with a true table each")
    of_render.add_argument("folder", type=pathlib.Path, metavar="FOLDER", help="where videos and tables go")
    of_render.add_argument("heads", nargs="+", type=pathlib.Path, metavar="HEAD.glb")
    of_render.add_argument("--three", type=pathlib.Path, required=True, help="the unpacked package three of npm")
    of_render.add_argument("--curves", type=pathlib.Path, default="../shared/curves", help="recordings of Live Link Face")
    of_render.add_argument("--lights", nargs="+", choices=LIGHTS, default=LIGHTS, help="which lights (default: all)")
    of_render.set_defaults(run=render_all)
    of_judge = commands.add_parser("judge", help="compare `facewire track` and MediaPipe with the truth of all videos")
    of_judge.add_argument("videos", nargs="+", type=pathlib.Path, metavar="VIDEO", help="a video of `render`")
    of_judge.add_argument("--model", help="passed to `facewire track`")
    of_judge.add_argument("--mediapipe", type=pathlib.Path, metavar="FILE.task", help="run MediaPipe, too, with this model")
    of_judge.set_defaults(run=judge_all)
    arguments = parser.parse_args()
    arguments.run(arguments)


if __name__ == "__main__":
    main()
