#!/usr/bin/env python3
"""Installs the landmark networks and ONNX Runtime in the folder where facewire looks for them.

Downloads, converts and checks the files, and moves them into the folder only then. The last
one, SOURCES.txt, lists every input and output with its sha256. If the folder agrees with its
SOURCES.txt and the inputs have not changed, nothing is done.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import sys
from pathlib import Path

import sources
from sources import SetupError

HERE = Path(__file__).parent
STAMP = "SOURCES.txt"
LIBRARY = "libonnxruntime.so"
NETWORKS = ("detector", "mesh", "lips", "left_eye", "right_eye")
OUTPUTS = (*(f"{name}.onnx" for name in NETWORKS), LIBRARY)


def cache_folder() -> Path:
    """Folder of the files that facewire can download or compute again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "facewire"


def networks_folder() -> Path:
    """Folder from which facewire loads the networks."""
    return Path(os.environ.get("FACEWIRE_NETWORKS") or cache_folder() / "networks")


def sources_text(folder: Path, architecture: str) -> str:
    """The content of a SOURCES.txt for the files in `folder` and the inputs as they are now."""
    converter = hashlib.sha256()
    files = [*HERE.glob("*.py"), HERE / "requirements.txt", HERE / "face.npz",
             HERE.parents[1] / "src/face/refinement.rs"]
    for file in sorted(files):
        converter.update(file.read_bytes())
    wheels = (sources.MEDIAPIPE, sources.ONNX_RUNTIME[architecture])
    lines = [f"{wheel.sha256}  {wheel}" for wheel in wheels]
    lines.append(f"{converter.hexdigest()}  models/networks")
    lines += [f"{sources.sha256_of(folder / name)}  {name}" for name in OUTPUTS]
    return "\n".join(lines) + "\n"


def is_current(folder: Path, architecture: str) -> bool:
    """Whether the files in `folder` are complete and made from the present inputs."""
    try:
        return (folder / STAMP).read_text(encoding="utf-8") == sources_text(folder, architecture)
    except FileNotFoundError:
        return False


def build(folder: Path, architecture: str) -> None:
    """Writes the networks and the library from the wheels into `folder`, and checks them."""
    downloads = cache_folder() / "downloads"
    mediapipe = sources.fetch(sources.MEDIAPIPE, downloads)
    library = sources.fetch(sources.ONNX_RUNTIME[architecture], downloads)
    print("networks: converting", flush=True)
    # Imported here because these modules need the packages of requirements.txt and take most of
    # a second, which a run that has nothing to do saves.
    import check
    import networks
    import refinement
    import to_onnx

    attention = sources.extract(mediapipe, sources.ATTENTION_MESH)
    refinement.check(attention, sources.extract(mediapipe, sources.GRAPHS))
    parts = networks.all_networks(sources.extract(mediapipe, sources.DETECTOR), attention)
    to_onnx.write(parts, folder, blocked=architecture in sources.BLOCKED_LAYOUT)
    check.check(parts, folder)
    sources.extract_to(library, sources.ONNX_RUNTIME_LIBRARY, folder / LIBRARY)


def install(architecture: str) -> None:
    """Builds the files in a temporary folder, then moves them into the final one."""
    folder = networks_folder()
    with sources.unfinished_folder(folder) as unfinished:
        new = Path(unfinished)
        build(new, architecture)
        (new / STAMP).write_text(sources_text(new, architecture), encoding="utf-8")
        for name in (*OUTPUTS, STAMP):
            os.replace(new / name, folder / name)
    print(f"networks: ready in {folder}")


def main() -> int:
    """Runs the command line and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--architecture", default=platform.machine(), metavar="NAME",
        help="machine that will run the networks: x86_64 or aarch64 (default: this one)",
    )
    architecture = parser.parse_args().architecture
    if architecture not in sources.ONNX_RUNTIME:
        print(f"networks: there is no ONNX Runtime for {architecture}", file=sys.stderr)
        return 1
    try:
        if not is_current(networks_folder(), architecture):
            install(architecture)
    except (SetupError, OSError) as error:
        print(f"networks: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
