#!/usr/bin/env python3
"""Writes the licences of all that is in the wheel for one Rust target to standard output: licences.py TARGET"""

import importlib.util
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
NETWORKS = """The networks in the extension module are those of face detection and of the face mesh in MediaPipe 0.10.14,
https://github.com/google-ai-edge/mediapipe. They were converted: the face mesh was cut into four networks, and all were written in
the file format of facewire's own engine. The lists of edges in facewire/_connections.py are MediaPipe's, too.
Copyright 2020-2024 The MediaPipe Authors, Apache License 2.0 (below)."""


def main():
    """Writes the text. What reads the packages is the script that does so for the Debian packages."""
    found = importlib.util.spec_from_file_location("copyright", ROOT / "packaging" / "copyright.py")
    debian = importlib.util.module_from_spec(found)
    found.loader.exec_module(debian)
    packages = debian.linked_packages(["facewire-python"], sys.argv[1], [])
    parts = ["facewire, Copyright 2026 The facewire authors, is licensed under the MIT licence or the Apache License 2.0.", NETWORKS,
             "These Rust packages are linked into the extension module:"]
    for package in packages:
        holders = "; ".join(debian.holders_of(package))
        parts.append(f"{package['name']} {package['version']} ({package['license']})\n    {holders}\n    {package['repository']}")
    parts += [f"{'=' * 100}\n{(ROOT / name).read_text('utf-8').strip()}" for name in ("LICENSE-MIT", "LICENSE-APACHE")]
    for package in packages:
        if "BSD" in package["license"] or "ISC" in package["license"]:
            (file, *_) = debian.files_of(package, "LICEN[SC]E*")
            parts.append(f"{'=' * 100}\n{package['name']}\n\n{file.read_text('utf-8').strip()}")
    print("\n\n".join(parts))


if __name__ == "__main__":
    main()
