"""`python -m facewire`: the face of a video as a table."""

from __future__ import annotations

import argparse
import contextlib
import csv
import itertools
import os
import sys
from typing import Any, ContextManager, Iterable, List, Optional

from . import BLENDSHAPES, Face, FaceTracker, FacewireError, TrackedFrame, __version__, track

_EXAMPLES = """\
examples:
  python -m facewire talk.mp4 -o talk.csv
  python -m facewire talk.mp4 --profile anna.toml -o talk.csv
  python -m facewire 0 -o live.csv              the first camera, until Ctrl-C
  python -m facewire /dev/video2 | tee live.csv

The columns are those of `facewire track`, and each row is written at once. A frame without a face has the state `neutral`
and zeros.
"""
_REGIONS = ("left_eye", "right_eye", "brows", "mouth", "cheeks", "face")
_HEAD = ("head_yaw_deg", "head_pitch_deg", "head_roll_deg", "head_x_mm", "head_y_mm", "head_z_mm")
_COLUMNS = ("frame", "time_s", "state", *BLENDSHAPES, *_HEAD, *(f"visibility_{region}" for region in _REGIONS))


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs the program, and returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m facewire",
        description="Writes a row for each frame of a video or a camera: coefficients, head pose and visibility.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", metavar="VIDEO", help="a file; or a camera, by its number or path")
    parser.add_argument("-o", "--out", metavar="FILE.csv", help="the table; without it, standard output")
    parser.add_argument("--profile", metavar="FILE.toml", help="the wearer's, made by `facewire calibrate`")
    parser.add_argument("--neutral", choices=("auto", "off"), help="whether the neutral face is estimated, without a profile")
    parser.add_argument("--mirror", action="store_true", help="swap left and right")
    parser.add_argument("--version", action="version", version=f"facewire {__version__}")
    given = parser.parse_args(arguments)
    source = int(given.source) if given.source.isdecimal() and not os.path.exists(given.source) else given.source
    try:
        tracker = FaceTracker(profile=given.profile, neutral=given.neutral, mirror=given.mirror)
        with track(source, tracker) as frames:
            # A table that exists is not touched before there is something to write.
            first = list(itertools.islice(frames, 1))
            if not first:
                raise FacewireError(f"{source} has no pictures")
            with _opened(given.out) as file:
                _write(itertools.chain(first, frames), file)
            return 0
    except FileNotFoundError as error:
        print(f"facewire: there is no file {error.filename or error}", file=sys.stderr)
    except BrokenPipeError:
        # Whoever read the table has left. What is still to be written to standard output at the exit goes nowhere.
        if given.out is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (FacewireError, OSError, ValueError) as error:
        print(f"facewire: {error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("facewire: stopped before the first frame", file=sys.stderr)
        return 130
    return 1


def _opened(path: Optional[str]) -> ContextManager[Any]:
    if path is None:
        return contextlib.nullcontext(sys.stdout)
    return open(path, "w", newline="", encoding="utf-8")


def _write(frames: Iterable[TrackedFrame], file: Any) -> None:
    table = csv.writer(file, lineterminator="\n")
    table.writerow(_COLUMNS)
    count = seen = 0
    try:
        for frame in frames:
            table.writerow(_row(frame))
            file.flush()
            count += 1
            seen += frame.face is not None
    except KeyboardInterrupt:
        file.flush()
    print(f"facewire: {count} frames, {seen} with a face", file=sys.stderr)


def _row(frame: TrackedFrame) -> List[str]:
    state, numbers = ("neutral", [0.0] * (len(_COLUMNS) - 3)) if frame.face is None else ("live", _numbers(frame.face))
    return [str(frame.number), f"{frame.time_s:.6f}", state, *(f"{number:.6f}" for number in numbers)]


def _numbers(face: Face) -> List[float]:
    visibility = face.visibility
    shown = [visibility[region] for region in _REGIONS]
    return [*face.coefficients.tolist(), *face.yaw_pitch_roll_deg, *face.position_mm, *shown]


if __name__ == "__main__":
    sys.exit(main())
