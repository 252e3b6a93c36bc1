"""Records what has passed on this machine. A stamp is an empty file. Its name consists of the name of what has passed, and a hash
of everything that this depends on."""

import hashlib
import json
import os
import pathlib
import platform
import subprocess
import sys

CACHE = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "facewire"
# Top-level folders whose files belong to a crate in another folder.
BELONGS = {"models": "facewire-face"}


def files(root):
    """Returns the hash of each file that git tracks or would add, by its path."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=True, stdout=subprocess.PIPE).stdout.decode()
    paths = sorted({path for path in listed.split("\0") if path and (root / path).is_file()})
    return {path: hashlib.sha256((root / path).read_bytes()).hexdigest() for path in paths}


def machine():
    """Returns what outcomes depend on besides files: the compiler, Python and the kind of processor."""
    rust = subprocess.run(["rustc", "-vV"], check=True, stdout=subprocess.PIPE, text=True).stdout
    return f"{rust}{sys.version}{platform.machine()}"


def stamp(name, about, contents):
    """Returns the path of the stamp of something that reads only these files, given as hashes by path."""
    told = [about, *(f"{path} {content}" for path, content in contents.items())]
    return CACHE / "proven" / f"{name}-{hashlib.sha256(chr(10).join(told).encode()).hexdigest()[:24]}"


def prove(path):
    """Creates a stamp."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


# --- crates ---


def workspace(root):
    """Returns the packages of the workspace by their names."""
    command = ["cargo", "metadata", "--format-version", "1", "--no-deps", "--locked"]
    described = json.loads(subprocess.run(command, cwd=root, check=True, stdout=subprocess.PIPE).stdout)
    return {package["name"]: package for package in described["packages"]}


def owners(root, packages, paths):
    """Returns the package that each file belongs to, by the file's path: that of the innermost folder with a package."""
    folders = {pathlib.Path(package["manifest_path"]).parent.relative_to(root): name for name, package in packages.items()}

    def owner(path):
        folder = next(folder for folder in pathlib.PurePath(path).parents if folder in folders)
        return BELONGS.get(path.partition("/")[0], folders[folder])

    return {path: owner(path) for path in paths}


def crate_stamps(root, packages, about, contents):
    """Returns the stamp of each package, which says that the tests of the package have passed with these files."""
    owned = owners(root, packages, contents)
    return {
        name: stamp(name, about, {path: content for path, content in contents.items() if owned[path] == name})
        for name in packages
    }
