#!/usr/bin/env python3
"""Checks the crates that have changed since their tests last passed on this machine, and the crates that are built from
them. `scripts/test quick` calls it. It leaves out the tests that take longest, and says which."""

import pathlib
import subprocess
import sys
import time

import compiled
import proof
import steps

ROOT = pathlib.Path(__file__).resolve().parents[2]
# The workbench, whose tests take minutes to compile and run, and which never runs on a board.
WORKBENCH = "facewire-fit"
# The tests that take longest: a minute of faults and other loads in real time, the service behind the console in a browser, whole
# videos by two engines, calibrations in real time, a second compiler, and sketches of boards.
LONG = ("avr", "calibrate", "golden", "heads", "impairments", "memory", "overload", "sketches", "soak")
# How many tests run at the same time: more than in the step `unit`, because nothing runs beside them.
THREADS = 8


def targets(packages, names):
    """Returns the options that make cargo build the targets of these packages without the long tests, the programs that these
    tests start, and the tests that read files of all packages. They select the whole workspace: a few packages alone would enable
    other features of their shared dependencies, which would all be compiled again."""
    programs = names.union(*(proof.STARTS.get(name, []) for name in names))
    chosen = {
        *(option for name in programs for option in targets_of(packages[name], "bin")),
        *(option for name in names for option in targets_of(packages[name], "test")),
        *(f"--test={name}" for name in proof.READS_ALL),
    }
    return ["--workspace", "--lib", *sorted(chosen)]


def targets_of(package, kind):
    """Returns options that select the targets of one kind of a package, without those that are left out."""
    found = [target for target in package["targets"] if kind in target["kind"]]
    return [f"--{kind}={target['name']}" for target in found if not is_left_out(target)]


def is_left_out(target):
    """Returns whether a target is a long test, or needs a feature that is not asked for."""
    return target["name"] in LONG or bool(target.get("required-features"))


def left_out(packages, names):
    """Returns the names of the targets of these packages that are left out."""
    return sorted(target["name"] for name in names for target in packages[name]["targets"] if is_left_out(target))


def lint(packages, names):
    """Returns the command that checks the targets of these packages by clippy. It can wait for others."""
    command = ["cargo", "clippy", "--quiet", *targets(packages, names), "--", "--deny", "warnings"]
    return ["nice", "-n", str(steps.PATIENT_NICENESS), *command]


def build(packages, names):
    """Returns the command that compiles the tests of these packages, and lists the programs."""
    options = ["--cargo-quiet", "--list-type", "binaries-only", "--message-format", "json"]
    return ["cargo", "nextest", "list", *options, *targets(packages, names)]


def run(names, binaries, metadata):
    """Returns the command that runs these packages' tests without cargo, from the lists of programs and of packages."""
    options = ["--no-fail-fast", f"--test-threads={THREADS}", "--binaries-metadata", str(binaries), "--cargo-metadata", str(metadata)]
    return ["cargo", "nextest", "run", *options, "--filterset", proof.tests_of(names)]


def check(packages, tested, changed):
    """Checks the format, compiles and runs the tests of some packages, and meanwhile has clippy check those that have changed
    themselves. Returns the command that failed, or `None`."""
    folder = steps.target_folder()
    binaries, metadata = folder / "quick-binaries.json", folder / "quick-metadata.json"
    format_, compile_ = ["cargo", "fmt", "--all", "--check"], build(packages, tested)
    if subprocess.run(format_, cwd=ROOT).returncode != 0:
        return format_
    with binaries.open("w") as file:
        if subprocess.run(compile_, cwd=ROOT, stdout=file).returncode != 0:
            return compile_
    with metadata.open("w") as file:
        subprocess.run(["cargo", "metadata", "--format-version", "1", "--all-features"], cwd=ROOT, check=True, stdout=file)
    with subprocess.Popen(lint(packages, changed) if changed else ["true"], cwd=ROOT) as linting:
        tests = subprocess.run(run(tested, binaries, metadata), cwd=ROOT)
    return next((done.args for done in (linting, tests) if done.returncode != 0), None)


def main():
    """Runs format, clippy and the tests."""
    began = time.monotonic()
    folder = steps.target_folder()
    folder.mkdir(parents=True, exist_ok=True)
    compiled.take(proof.CACHE, folder)
    packages = proof.workspace(ROOT)
    contents = proof.files(ROOT)

    def stamps(what, uses):
        return proof.crate_stamps(ROOT, packages, proof.machine(), contents, what, uses)

    proven = stamps("", proof.with_dependencies)
    tested = stamps("quick-", proof.with_libraries)
    linted = stamps("clippy-", lambda _, name: {name})
    to_test = {name for name in packages if not proven[name].exists() and not tested[name].exists()} - {WORKBENCH}
    to_lint = {name for name in to_test if not linted[name].exists()}
    print(f"changed: {' '.join(sorted(to_lint)) or 'no crate'}", flush=True)
    print(f"tested: {' '.join(sorted(to_test)) or 'documents and scripts'}", flush=True)
    failed = check(packages, to_test, to_lint)
    if failed:
        print(f"FAILED: {' '.join(failed[:6])} ({time.monotonic() - began:.0f} s)")
        return 1
    if proof.files(ROOT) == contents:
        for path in [*(tested[name] for name in to_test), *(linted[name] for name in to_lint)]:
            proof.prove(path)
    print(f"passed ({time.monotonic() - began:.0f} s)")
    left = ", ".join([WORKBENCH, *left_out(packages, to_test)])
    print(f"left to scripts/test: {left}, and crates that use a changed one in tests alone")
    return 0


if __name__ == "__main__":
    sys.exit(main())
