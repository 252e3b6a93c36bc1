#!/usr/bin/env python3
"""Runs the steps of scripts/test: in their order, several at a time, and only those that have not passed on this machine with the
same files yet. steps.toml describes the steps."""

import argparse
import contextlib
import dataclasses
import fcntl
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib

import compiled
import proof

ROOT = pathlib.Path(__file__).resolve().parents[2]
# The step that runs the tests of all crates.
TESTS = "unit"
# How many steps run at the same time. Few of them keep two cores busy all the time.
BESIDE = max(1, int(os.environ.get("FACEWIRE_STEPS", "3")))
# The priority of the steps that follow no clock, as for nice(1). Those that follow one get nine parts of ten of a processor that
# both want.
PATIENT_NICENESS = 10
# The exit status of a step that this machine cannot run. The last line of its output says why.
SKIPPED = 77
# How far back a change is recent. A machine that can run the settled steps must test a change within so many commits.
RECENT_COMMITS = 15
# Where the steps are described.
LIST = "scripts/testing/steps.toml"
# Seconds between two lines that say which steps are running.
PROGRESS_S = 60


@dataclasses.dataclass
class Step:
    """A step, as steps.toml describes it."""

    name: str
    group: str
    command: str
    reads: list
    after: list = dataclasses.field(default_factory=list)
    lane: str = ""
    makes: bool = False
    clocked: bool = False
    settled: bool = False


@dataclasses.dataclass
class Outcome:
    """How a step ended. The verdict is "passed", "FAILED", "skipped" if this machine cannot run the step, "not run" if a step that
    it needs has not passed, "proven" if it has passed on this machine before with the same files, or "left" to `--all`."""

    verdict: str
    wall_s: float = 0.0
    cpu_s: float = 0.0


def load(path):
    """Returns the steps that a file describes."""
    return read(path.read_text())


def read(text):
    """Returns the steps that a text describes, with the names of patterns replaced by the patterns."""
    described = tomllib.loads(text)
    named = described["patterns"]

    def patterns(reads):
        for pattern in reads:
            yield from patterns(named[pattern[1:]]) if pattern.startswith("@") else [pattern]

    return [Step(**{**step, "reads": list(patterns(step["reads"]))}) for step in described["step"]]


# --- which run ---


def is_read(step, path):
    """Returns whether a change of the file can change the outcome of the step."""
    return proof.includes(step.reads, path)


def stamp(step, about, contents):
    """Returns the stamp of the step for these files."""
    read = {path: content for path, content in contents.items() if is_read(step, path)}
    return proof.stamp(step.name, f"{about}{step.command}", read)


def needed(steps, proven):
    """Returns the names of the steps to run: those that are not proven, and those that make files for them."""
    wanted = {step.name for step in steps if step.name not in proven}
    for step in reversed(steps):
        if step.makes and any(step.name in other.after for other in steps if other.name in wanted):
            wanted.add(step.name)
    return wanted


def settled(root, steps):
    """Returns the names of the settled steps that have never run on this machine, and have not changed recently, nor has what they
    read. There are none if git does not tell what has changed."""
    try:
        before = commit_before(root)
        changed = changed_since(root, before)
        steps_before = read(git(root, "show", f"{before}:{LIST}")) if LIST in changed else steps
    except (subprocess.CalledProcessError, IndexError):
        return set()

    # A new step, and one whose command or patterns have changed, are not among them.
    unchanged = {(step.name, step.command, *step.reads) for step in steps_before}

    def is_recent(step):
        is_unchanged = (step.name, step.command, *step.reads) in unchanged
        return not is_unchanged or any(is_read(step, path) for path in changed)

    return {step.name for step in steps if step.settled and not proof.has_run(step.name) and not is_recent(step)}


def commit_before(root):
    """Returns the commit before the recent ones. Raises `IndexError` if there is none."""
    return git(root, "rev-list", "--first-parent", f"--max-count={RECENT_COMMITS + 1}", "HEAD").split()[RECENT_COMMITS]


def changed_since(root, commit):
    """Returns the paths of the files that have been changed, added or removed since a commit."""
    tracked = git(root, "diff", "--no-renames", "--no-ext-diff", "--relative", "--name-only", "-z", commit)
    new = git(root, "ls-files", "-z", "--others", "--exclude-standard")
    return {path for path in (tracked + new).split("\0") if path}


def git(root, *arguments):
    """Returns what git prints."""
    run = subprocess.run(["git", *arguments], cwd=root, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return os.fsdecode(run.stdout)


# --- running ---


class Run:
    """One run of steps. Each step writes its output, and what it skips, into files of its own in the folder."""

    def __init__(self, root, steps, folder, environment, prove):
        self.root = root
        self.steps = steps
        self.folder = folder
        self.environment = environment
        # A function that is called with each step that has passed, and with what the step has skipped.
        self.prove = prove
        self.outcomes = {}
        # The steps that are running, and when they began.
        self.running = {}
        self.children = []
        self.ended = threading.Condition()

    def run(self, wanted):
        """Runs the steps with these names; the others are proven. Returns how every step ended."""
        waiting = [step for step in self.steps if step.name in wanted]
        self.outcomes = {step.name: Outcome("proven") for step in self.steps if step.name not in wanted}
        with self.ended:
            while waiting or self.running:
                step = next((step for step in waiting if self.is_next(step)), None)
                if step is not None:
                    waiting.remove(step)
                    self.begin(step)
                elif not self.ended.wait(PROGRESS_S):
                    self.say_progress()
        return self.outcomes

    def is_next(self, step):
        """Returns whether the step can begin, or be given up: all steps before it have ended, and there is room for it."""
        others = [other for other, _ in self.running.values()]
        is_free = not any(step.lane and step.lane == other.lane for other in others)
        is_undisturbed = not any(step.clocked and other.clocked for other in others)
        return len(others) < BESIDE and is_free and is_undisturbed and all(name in self.outcomes for name in step.after)

    def begin(self, step):
        """Starts a step, unless one before it has failed."""
        lost = [name for name in step.after if self.outcomes[name].verdict not in ("passed", "proven")]
        if lost:
            self.outcomes[step.name] = Outcome("not run")
            self.skip(step, f"it needs {', '.join(lost)}")
            return
        self.running[step.name] = (step, time.monotonic())
        priority = [] if step.clocked else ["nice", "-n", str(PATIENT_NICENESS)]
        with self.log(step).open("w") as log:
            child = subprocess.Popen(
                [*priority, "bash", "-euo", "pipefail", "-c", step.command],
                cwd=self.root, env=self.environment_of(step), stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )
        if not step.clocked:
            lower_priority_of_session(child.pid)
        self.children.append(child)
        threading.Thread(target=self.wait, args=(step, child), daemon=True).start()

    def wait(self, step, child):
        """Waits for the end of a step, records how it ended, and prints that."""
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        with self.ended:
            try:
                self.note_end(step, child, used)
            finally:
                self.ended.notify()

    def note_end(self, step, child, used):
        """Notes, proves and prints how a step ended that has used these resources."""
        self.children.remove(child)
        _, began = self.running.pop(step.name)
        verdict = {0: "passed", SKIPPED: "skipped"}.get(child.returncode, "FAILED")
        if verdict == "skipped" and not self.may_skip(step):
            verdict = "FAILED"
        outcome = Outcome(verdict, time.monotonic() - began, used.ru_utime + used.ru_stime)
        self.outcomes[step.name] = outcome
        self.say_end(step, outcome)
        if verdict == "passed":
            self.prove(step, self.skips(step))

    def may_skip(self, step):
        """Records that a step was skipped, for the reason in the last line of its output. Returns whether it may be skipped."""
        *_, why = self.log(step).read_text(errors="replace").strip().splitlines() or [""]
        return self.skip(step, why) == 0

    def skip(self, step, why):
        """Records that a step was skipped. Returns the exit status of scripts/skip."""
        command = [ROOT / "scripts" / "skip", f"step {step.name}: {why}"]
        with self.log(step).open("a") as log:
            return subprocess.run(command, env=self.environment_of(step), stderr=log).returncode

    def say_end(self, step, outcome):
        """Prints how a step ended: with a line of its output, or with all of it if the step has failed."""
        said = self.log(step).read_text(errors="replace").splitlines()
        words = [line.strip() for line in said if line.strip()] or [""]
        sentence = next((line for line in reversed(words) if " passed" in line), words[-1])
        print(f"{outcome.verdict}  {step.name} ({outcome.wall_s:.0f} s) {sentence}", flush=True)
        if outcome.verdict == "FAILED":
            print("\n".join(f"    {line}" for line in said), flush=True)

    def say_progress(self):
        """Prints which steps are running, and for how long."""
        now = time.monotonic()
        print("running: " + ", ".join(f"{name} {now - began:.0f} s" for name, (_, began) in self.running.items()), flush=True)

    def stop(self):
        """Ends the steps that are running, with all processes that they have started."""
        for child in list(self.children):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGTERM)

    def environment_of(self, step):
        """Returns the environment of a step, which names the step's own list of what it skips."""
        return {**self.environment, "FACEWIRE_SKIPPED": str(self.skipped(step)), "FACEWIRE_STEPS_FOLDER": str(self.folder)}

    def log(self, step):
        """Returns the file of the step's output."""
        return self.folder / f"{step.name}.log"

    def skipped(self, step):
        """Returns the file that lists what the step could not run, one line for each."""
        return self.folder / f"{step.name}.skipped"

    def skips(self, step):
        """Returns what the step could not run."""
        path = self.skipped(step)
        return path.read_text(errors="replace").splitlines() if path.exists() else []


def lower_priority_of_session(leader):
    """Lowers the priority of a session. Some kernels share the processors between sessions first, and only then between the
    processes of each (see "autogroup" in sched(7))."""
    with contextlib.suppress(OSError):
        pathlib.Path(f"/proc/{leader}/autogroup").write_text(str(PATIENT_NICENESS))


# --- the command ---


def target_folder():
    """Returns the folder that cargo builds in."""
    return (ROOT / os.environ.get("CARGO_TARGET_DIR", "target")).absolute()


def chosen(steps, names):
    """Returns the steps of these groups or names, and those that must pass before them."""
    known = {step.group for step in steps} | {step.name for step in steps}
    for name in names:
        if name not in known:
            sys.exit(f"scripts/test: no such step: {name}. There are: {' '.join(sorted(known))}")
    wanted = {step.name for step in steps if not names or step.group in names or step.name in names}
    for step in reversed(steps):
        if step.name in wanted:
            wanted |= set(step.after)
    return [step for step in steps if step.name in wanted]


def say_table(run):
    """Prints how long each step took."""
    print(f"\n{'step':<16}{'wall':>8}{'CPU':>8}")
    for step in run.steps:
        outcome = run.outcomes[step.name]
        times = f"{outcome.wall_s:>6.0f} s{outcome.cpu_s:>6.0f} s" if outcome.verdict in ("passed", "FAILED") else f"{'':>8}{'':>8}"
        print(f"{step.name:<16}{times}  {outcome.verdict}")


def conclude(run, left_out, began):
    """Prints the verdict on a run, and returns its exit status."""
    say_table(run)
    skips = sorted(line for step in run.steps for line in run.skips(step)) + [f"step {name}: not asked for" for name in left_out]
    left = [name for name, outcome in run.outcomes.items() if outcome.verdict == "left"]
    skips += [f"step {name}: left to --all: nothing that it reads has changed in the last {RECENT_COMMITS} commits" for name in left]
    failed = [name for name, outcome in run.outcomes.items() if outcome.verdict == "FAILED"]
    print(f"\n== {'FAILED: ' + ' '.join(failed) if failed else 'passed'}, {len(skips)} skipped ({time.monotonic() - began:.0f} s)")
    print("\n".join(skips))
    return 1 if failed else 0


def test(root, steps, folder, *, everything, asked=()):
    """Runs the steps that are not proven or, if `everything` is set, all of them. Leaves out no settled step if steps are `asked`
    for by name. Returns the run."""
    about = proof.machine()
    contents = proof.files(root)
    stamps = {step.name: stamp(step, about, contents) for step in steps}
    packages = proof.workspace(root) if (root / "Cargo.toml").exists() else {}
    crates = proof.crate_stamps(root, packages, about, contents) if packages else {}
    unproven = {name for name, path in crates.items() if everything or not path.exists()}

    def prove(step, skips):
        # The step proves nothing if a file that it reads has changed while it ran.
        if stamp(step, about, proof.files(root)) != stamps[step.name]:
            return
        if not skips:
            proof.prove(stamps[step.name])
        if step.name == TESTS:
            for name in unproven - crates_that_skip(packages, skips):
                proof.prove(crates[name])

    environment = {
        **os.environ, "FACEWIRE_TEST_ALL": "1" if everything else "",
        "FACEWIRE_STEPS_TESTS": "all()" if everything else proof.tests_of(unproven),
    }
    if "CARGO_TARGET_DIR" in environment:
        # Tests run in the folders of their crates, from which a relative path would lead elsewhere.
        environment["CARGO_TARGET_DIR"] = str(target_folder())
    run = Run(root, steps, folder, environment, prove)
    proven = set() if everything else {name for name, path in stamps.items() if path.exists()}
    left = set() if everything or asked else settled(root, steps)
    wanted = needed(steps, proven | left)
    try:
        run.run(wanted)
        run.outcomes.update({name: Outcome("left") for name in left - wanted})
        for name, outcome in run.outcomes.items():
            if outcome.verdict == "FAILED":
                proof.prove(proof.failure(name))
    finally:
        run.stop()
    return run


def crates_that_skip(packages, skips):
    """Returns the packages to which the programs belong that have skipped tests: all, if none of them has such a program. A
    line of `skips` begins with the name of the program."""
    found = [proof.with_program(packages, line.partition(" ")[0]) for line in skips]
    return set().union(*found) if all(found) else set(packages)


def wait_for(lock):
    """Waits until no other run uses this target folder."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        print("scripts/test: waiting for another run in this folder", flush=True)
        fcntl.flock(lock, fcntl.LOCK_EX)


def main():
    """Runs the steps that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="*", help="steps of steps.toml, or groups of them")
    parser.add_argument("--all", action="store_true", help="also run what has passed before, and the parts of steps that take long")
    parser.add_argument("--check", action="store_true", help="only see whether there are such steps")
    arguments = parser.parse_args()
    began = time.monotonic()
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, lambda number, _: sys.exit(128 + number))
    known = load(pathlib.Path(__file__).with_name("steps.toml"))
    steps = chosen(known, arguments.steps)
    if arguments.check:
        return 0
    target = target_folder()
    target.mkdir(parents=True, exist_ok=True)
    with (target / "steps.lock").open("w") as lock:
        wait_for(lock)
        folder = target / "steps"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        compiled.take(proof.CACHE, target)
        run = test(ROOT, steps, folder, everything=arguments.all, asked=arguments.steps)
        # Only now does nobody write into the target folder any more.
        compiled.give(proof.CACHE, target)
        return conclude(run, [step.name for step in known if step not in steps], began)


if __name__ == "__main__":
    sys.exit(main())
