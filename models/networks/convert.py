#!/usr/bin/env python3
"""Installs the landmark networks in the folder where facewire looks for them.

By default, writes them in the form of facewire's own engine. With --onnx, writes them as ONNX,
with the library of ONNX Runtime beside them. All files are complete before the first one is moved
into the folder. The last one, SOURCES.txt or SOURCES-onnx.txt, lists every input and output with
its sha256. If the files in the folder have these sums and the inputs have not changed, nothing is
done.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import sources
from sources import SetupError, Wheel

HERE = Path(__file__).parent
LIBRARY = "libonnxruntime.so"
NETWORKS = ("detector", "mesh", "lips", "left_eye", "right_eye")


@dataclass(frozen=True)
class Form:
    """A form of the networks: its files, the file that lists them, the packages that it needs, and
    the function that writes the files into a folder."""

    outputs: tuple[str, ...]
    stamp: str
    wheels: tuple[Wheel, ...]
    build: Callable[[Path], None]


def native() -> Form:
    """The form of facewire's own engine, which is the same for all machines."""
    return Form(tuple(f"{name}.fwnet" for name in NETWORKS), "SOURCES.txt", (sources.MEDIAPIPE,), build_native)


def onnx(architecture: str) -> Form:
    """The form of ONNX Runtime, which depends on the machine."""
    library = sources.ONNX_RUNTIME[architecture]
    outputs = (*(f"{name}.onnx" for name in NETWORKS), LIBRARY)
    return Form(outputs, "SOURCES-onnx.txt", (sources.MEDIAPIPE, library),
                lambda folder: build_onnx(folder, architecture))


def cache_folder() -> Path:
    """Folder of the files that facewire can download or compute again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "facewire"


def networks_folder() -> Path:
    """Folder from which facewire loads the networks."""
    return Path(os.environ.get("FACEWIRE_NETWORKS") or cache_folder() / "networks")


def sources_text(folder: Path, form: Form) -> str:
    """Returns the list of sums for the current inputs and the files in `folder`."""
    converter = hashlib.sha256()
    files = [*HERE.glob("*.py"), *HERE.glob("requirements*.txt"), HERE / "face.npz",
             HERE.parents[1] / "face/src/track/refinement.rs"]
    for file in sorted(files):
        converter.update(file.read_bytes())
    lines = [f"{wheel.sha256}  {wheel}" for wheel in form.wheels]
    lines.append(f"{converter.hexdigest()}  models/networks")
    lines += [f"{sources.sha256_of(folder / name)}  {name}" for name in form.outputs]
    return "\n".join(lines) + "\n"


def is_current(folder: Path, form: Form) -> bool:
    """Returns whether the files in `folder` are complete and were made from the current inputs."""
    try:
        return (folder / form.stamp).read_text(encoding="utf-8") == sources_text(folder, form)
    except FileNotFoundError:
        return False


def cut_networks() -> list:
    """Cuts the networks out of MediaPipe's files, and checks that facewire has the same tables as these files."""
    # Imported here because a run that has nothing to do needs none of the packages.
    import networks
    import refinement

    mediapipe = sources.fetch(sources.MEDIAPIPE, cache_folder() / "downloads")
    attention = sources.extract(mediapipe, sources.ATTENTION_MESH)
    refinement.check(attention, sources.extract(mediapipe, sources.GRAPHS))
    return networks.all_networks(sources.extract(mediapipe, sources.DETECTOR), attention)


def build_native(folder: Path) -> None:
    """Writes the networks in the form of facewire's own engine."""
    import to_native

    to_native.write(cut_networks(), folder)


def build_onnx(folder: Path, architecture: str) -> None:
    """Writes the networks as ONNX, compares them with the TFLite interpreter, and adds the library."""
    import check
    import to_onnx

    library = sources.fetch(sources.ONNX_RUNTIME[architecture], cache_folder() / "downloads")
    parts = cut_networks()
    to_onnx.write(parts, folder, blocked=architecture in sources.BLOCKED_LAYOUT)
    check.check(parts, folder)
    sources.extract_to(library, sources.ONNX_RUNTIME_LIBRARY, folder / LIBRARY)


def install(form: Form) -> None:
    """Builds the files in a temporary folder, then moves them into the final one."""
    folder = networks_folder()
    with sources.unfinished_folder(folder) as unfinished:
        new = Path(unfinished)
        form.build(new)
        (new / form.stamp).write_text(sources_text(new, form), encoding="utf-8")
        for name in (*form.outputs, form.stamp):
            os.replace(new / name, folder / name)
    print(f"networks: ready in {folder}")


def main() -> int:
    """Runs the command line and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--onnx", action="store_true", help="write ONNX files and add the library of ONNX Runtime")
    parser.add_argument(
        "--architecture", default=platform.machine(), metavar="NAME",
        help="machine of ONNX Runtime: x86_64 or aarch64 (default: this one)",
    )
    arguments = parser.parse_args()
    if arguments.onnx and arguments.architecture not in sources.ONNX_RUNTIME:
        names = " and ".join(sources.ONNX_RUNTIME)
        print(f"networks: there is no ONNX Runtime for {arguments.architecture}, only for {names}", file=sys.stderr)
        return 1
    form = onnx(arguments.architecture) if arguments.onnx else native()
    try:
        if not is_current(networks_folder(), form):
            install(form)
    except (SetupError, OSError) as error:
        print(f"networks: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
