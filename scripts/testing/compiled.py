"""Keeps compiled registry crates, so that the other checkouts on a machine need not compile them again.

A compiled registry crate depends on its source, its features, its profile and the compiler, all of which the names of its files
contain as a hash, and few depend on the checkout. Crates of this repository are never kept: cargo judges by the times of their
source files whether they are up to date, and these times differ between checkouts.

Usage: compiled.py SOURCE TARGET
Adds to cargo's target folder TARGET the crates that the target folder SOURCE holds.
"""

import contextlib
import fcntl
import filecmp
import os
import pathlib
import re
import shutil
import sys

# The prefix of the names of this repository's packages.
OWN = "facewire"
# Files that the compiler never changes in place: it writes a new file and renames it. So they can be hard-linked safely.
LINKED = {".rlib", ".rmeta", ".so"}


def units(profile):
    """Yields the files of the registry crates in a folder of cargo that has a folder `.fingerprint`: the fingerprint last, without
    which cargo compiles a crate again."""
    names = [path.name for path in (profile / ".fingerprint").iterdir() if not path.name.startswith(OWN)]
    hashes = {name.rpartition("-")[2] for name in names}
    for path in (profile / "deps").glob("*"):
        found = re.search(r"-([0-9a-f]{16})\.", path.name)
        if found and found[1] in hashes:
            yield path
    for kind in ("build", ".fingerprint"):
        for name in names:
            yield from (path for path in (profile / kind / name).rglob("*") if path.is_file())


def copy(source, target):
    """Adds to the target folder `target` the registry crates of the target folder `source` that it lacks. Leaves out the profiles
    that cargo is building now, and those in which the folders disagree."""
    # target/PROFILE, target/TRIPLE/PROFILE
    for fingerprints in [*source.glob("*/.fingerprint"), *source.glob("*/*/.fingerprint")]:
        profile = fingerprints.parent
        with reserved(profile) as is_free, reserved(target / profile.relative_to(source)) as is_other_free:
            if is_free and is_other_free:
                add([(path, target / path.relative_to(source)) for path in units(profile)])


def add(pairs):
    """Places each file where it belongs, unless one is already there. Places nothing if a compiled crate there has other
    contents: a crate that contains output of its build script depends on the checkout, and the crates that use it fit only that
    build."""
    there = [(path, to) for path, to in pairs if to.exists()]
    if not all(path.samefile(to) or filecmp.cmp(path, to, shallow=False) for path, to in there if path.suffix in LINKED):
        return
    for path, to in pairs:
        if not to.exists():
            to.parent.mkdir(parents=True, exist_ok=True)
            place(path, to)


@contextlib.contextmanager
def reserved(profile):
    """Yields whether no cargo builds in the folder of a profile. If so, none begins meanwhile."""
    lock = profile / ".cargo-lock"
    if not lock.exists():
        yield True
        return
    with lock.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True


def place(path, to):
    """Links or copies a file, whole or not at all. A copy keeps the time of the file, because cargo compares it."""
    if path.suffix in LINKED:
        try:
            os.link(path, to)
            return
        except OSError:
            # The cache is on another file system.
            pass
    incomplete = to.with_name(f"{to.name}.incomplete")
    shutil.copy2(path, incomplete)
    incomplete.replace(to)


@contextlib.contextmanager
def kept(cache):
    """Locks the folder of the cache that holds compiled crates, and yields its path. Only one checkout uses it at a time."""
    folder = cache / "compiled"
    folder.mkdir(parents=True, exist_ok=True)
    with (cache / "compiled.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield folder


def take(cache, target):
    """Fills a target folder with the crates that this machine has compiled before."""
    with kept(cache) as folder:
        copy(folder, target)


def give(cache, target):
    """Keeps the crates that a target folder holds."""
    with kept(cache) as folder:
        copy(target, folder)


if __name__ == "__main__":
    copy(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
