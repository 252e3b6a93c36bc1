#!/usr/bin/env python3
"""Checks the crates that have changed since their tests last passed on this machine, and the crates that depend on
them. `scripts/test quick` calls it."""

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


def with_dependents(packages, names):
    """Returns these packages, and all that depend on them or use them in tests."""
    found = set(names)
    while True:
        more = {name for name, package in packages.items() if found & {needed["name"] for needed in package["dependencies"]}}
        if more <= found:
            return found
        found |= more


def targets(packages, names):
    """Returns the options that make cargo build the targets of these packages. They select the whole workspace: a few
    packages alone would enable other features of their shared dependencies, which would all be compiled again."""
    options = ["--workspace", "--lib"]
    for name in sorted(names):
        for target in packages[name]["targets"]:
            kind = target["kind"][0]
            if kind in ("bin", "test"):
                options += [f"--{kind}", target["name"]]
    return options


def commands(packages, affected):
    """Returns the commands that check these packages."""
    yield ["cargo", "fmt", "--all", "--check"]
    if affected:
        options = targets(packages, affected)
        chosen = " + ".join(f"package(={name})" for name in sorted(affected))
        yield ["cargo", "clippy", "--quiet", *options, "--", "--deny", "warnings"]
        yield ["cargo", "nextest", "run", "--cargo-quiet", "--no-fail-fast", *options, "--filterset", chosen]


def main():
    """Runs format, clippy and the tests."""
    began = time.monotonic()
    compiled.take(proof.CACHE, steps.target_folder())
    packages = proof.workspace(ROOT)
    contents = proof.files(ROOT)
    stamps = proof.crate_stamps(ROOT, packages, proof.machine(), contents)
    changed = [name for name in packages if not stamps[name].exists()]
    affected = with_dependents(packages, changed) - {WORKBENCH}
    print(f"changed: {' '.join(changed) or 'nothing'}; checked: {' '.join(sorted(affected)) or 'the format'}", flush=True)
    for command in commands(packages, affected):
        if subprocess.run(command, cwd=ROOT).returncode != 0:
            print(f"FAILED: {' '.join(command[:3])} ({time.monotonic() - began:.0f} s)")
            return 1
    if proof.files(ROOT) == contents:
        for name in affected:
            proof.prove(stamps[name])
    print(f"passed ({time.monotonic() - began:.0f} s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
