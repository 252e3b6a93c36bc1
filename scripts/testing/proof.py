"""Records what has passed on this machine. A stamp is an empty file. Its name consists of the name of what has passed, and a hash
of everything that this depends on."""

import fnmatch
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
# Files that several crates are compiled or tested with.
SHARED = (
    ".cargo/*", ".config/*", "Cargo.lock", "Cargo.toml", "boards/*", "clippy.toml", "docs/code.md", "docs/reference.md",
    "fuzz/src/*", "library/tests/common/*", "packaging/bridge/*", "rust-toolchain*", "systemd/*", "tests/common/*",
    "tests/golden/*", "tests/hooks/*", "tests/receivers.py", "tests/skips-allowed",
)
# The tests that read files of all crates, documents and scripts, and files that no other test reads.
READS_ALL = ("project", "setup")
READ_BY_THEM = (
    "docs/*", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "README.md", "cross/*", "packaging/*", "scripts/*",
    "tests/cases.md", "tests/guest/*", "!docs/receivers.md",
)
# Files of a crate that those which use the crate do not read.
UNUSED = ("*.md", "*/tests.rs", "*_tests.rs", "docs/*", "tests/*", "*/tests/*", "cross/*", "packaging/*", "scripts/*")
# Crates whose programs the tests of a crate start, though cargo knows of no dependency.
STARTS = {"facewire": ["facewire-tools"], "facewire-console": ["facewire", "facewire-tools"]}


def paths(root):
    """Returns the paths of the files that git tracks or would add."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, stdout=subprocess.PIPE)
    found = sorted({path for path in os.fsdecode(listed.stdout).split("\0") if path and (root / path).is_file()})
    if not found:
        sys.exit(f"scripts/test: git lists no files in {root}, and without them nothing can be proven: use a git checkout")
    return found


def files(root):
    """Returns the hash of each file, with whether it may be executed, by its path."""

    def content(path):
        return f"{hashlib.sha256(path.read_bytes()).hexdigest()} {path.stat().st_mode & 0o111:o}"

    return {path: content(root / path) for path in paths(root)}


def machine():
    """Returns what outcomes depend on besides files: the compiler, Python, the kind of processor, and variables for cargo and tests."""
    rust = subprocess.run(["rustc", "-vV"], check=True, stdout=subprocess.PIPE, text=True).stdout
    variables = [f"{name}={value}" for name, value in sorted(os.environ.items()) if is_read_by_builds(name)]
    return "\n".join([rust, sys.version, platform.machine(), *variables])


def is_read_by_builds(name):
    """Returns whether a variable of the environment can change what is built or tested, rather than where."""
    return name.startswith(("CARGO_", "FACEWIRE_", "NEXTEST_", "RUSTC", "RUSTDOCFLAGS", "RUSTFLAGS")) and name not in (
        "CARGO_HOME", "CARGO_TARGET_DIR", "FACEWIRE_SCREENSHOTS", "FACEWIRE_STEPS", "FACEWIRE_TEST_ALL"
    )


def stamp(name, about, contents):
    """Returns the path of the stamp of something that reads only these files, given as hashes by path."""
    told = "\n".join([about, *(f"{path} {content}" for path, content in contents.items())])
    return CACHE / "proven" / f"{name}-{hashlib.sha256(os.fsencode(told)).hexdigest()[:24]}"


def failure(name):
    """Returns the path of the stamp that says that something of this name has failed on this machine."""
    return CACHE / "proven" / f"{name}-failed"


def has_run(name):
    """Returns whether something of this name has passed or failed on this machine, whatever files it has read."""
    return any(path.name.rpartition("-")[0] == name for path in (CACHE / "proven").glob(f"{name}-*"))


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


def crate_stamps(root, packages, about, contents, what="", uses=None):
    """Returns the stamp of each package, which says that its tests have passed with these files: its own, those of the packages that
    it uses, and those that several packages share. Other stamps have another name and use other packages."""
    owned = owners(root, packages, contents)
    used = {name: (uses or with_dependencies)(packages, name) for name in packages}

    def reads(name, path):
        if owned[path] == name:
            return includes(SHARED, path) or not includes(READ_BY_THEM, path)
        return includes(SHARED, path) or owned[path] in used[name] and not includes(UNUSED, path)

    return {
        name: stamp(what + name, about, {path: content for path, content in contents.items() if reads(name, path)})
        for name in packages
    }


def with_dependencies(packages, name):
    """Returns the package, and those of the workspace that it or its tests use."""

    def needs(crate):
        return [needed["name"] for needed in packages[crate]["dependencies"]] + STARTS.get(crate, [])

    return closure(name, needs, packages)


def with_libraries(packages, name):
    """Returns the package, and those of the workspace that it is built from: not those that its tests alone use."""

    def needs(crate):
        return [needed["name"] for needed in packages[crate]["dependencies"] if needed["kind"] != "dev"]

    return closure(name, needs, packages)


def closure(name, needs, packages):
    """Returns the package, and all packages of the workspace that it needs in any number of steps."""
    found, new = set(), {name}
    while new:
        found |= new
        new = {other for crate in new for other in needs(crate) if other in packages} - found
    return found


def with_program(packages, program):
    """Returns the packages with a test program of this name, as cargo writes it."""
    return {name for name, package in packages.items() if any(is_called(target, program) for target in package["targets"])}


def is_called(target, program):
    """Returns whether the programs of a target of cargo have this name."""
    return target["name"].replace("-", "_") == program


def tests_of(names):
    """Returns nextest's expression for the tests of these packages and those that read files of all."""
    return " + ".join([*(f"binary(={name})" for name in READS_ALL), *(f"package(={name})" for name in sorted(names))])


def includes(patterns, path):
    """Returns whether the last pattern that matches a path includes it. A pattern with a ! leaves out what it matches, and a * stands for
    any characters, slashes too."""
    decided = False
    for pattern in patterns:
        if fnmatch.fnmatchcase(path, pattern.removeprefix("!")):
            decided = not pattern.startswith("!")
    return decided
