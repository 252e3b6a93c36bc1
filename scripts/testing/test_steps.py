"""The steps of scripts/test run when what they read has changed, and only then."""

import fcntl
import os
import pathlib
import re
import subprocess
import tempfile
import unittest
from unittest import mock

import compiled
import proof
import quick
import steps

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Most tests stand in for it.
MACHINE = proof.machine


class Checkout(unittest.TestCase):
    """A checkout with some of the files of this one, in which each step only notes that it ran."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name) / "checkout"
        self.ran = pathlib.Path(folder.name) / "ran"
        self.said = []
        self.steps = steps.load(pathlib.Path(__file__).with_name("steps.toml"))
        # For each step the last file that it reads, which differs between most steps; and a file that few steps read.
        everything = list(proof.files(ROOT))
        last = {step.name: next(path for path in reversed(everything) if steps.is_read(step, path)) for step in self.steps}
        self.paths = sorted({*last.values(), "docs/faults.md"})
        for path in self.paths:
            (self.root / path).parent.mkdir(parents=True, exist_ok=True)
            (self.root / path).write_text("as it was")
        subprocess.run(["git", "init", "--quiet"], cwd=self.root, check=True)
        for step in self.steps:
            step.command = f"echo {step.name} >>{self.ran}"
        for patched in (
            mock.patch.object(proof, "CACHE", pathlib.Path(folder.name) / "cache"),
            mock.patch.object(proof, "machine", lambda: ""),
            mock.patch.object(steps, "print", lambda *words, **_: self.said.append(" ".join(words)), create=True),
            mock.patch.dict(os.environ, {"CI": ""}),
        ):
            patched.start()
            self.addCleanup(patched.stop)

    def run_all(self, *, everything=False):
        """Runs the steps, and returns the names of those that ran."""
        self.ran.write_text("")
        folder = pathlib.Path(tempfile.mkdtemp(dir=self.ran.parent))
        self.run_of_steps = steps.test(self.root, self.steps, folder, everything=everything)
        return set(self.ran.read_text().split())

    def step(self, name):
        return next(step for step in self.steps if step.name == name)

    def read_by(self, name):
        return next(path for path in reversed(self.paths) if steps.is_read(self.step(name), path))

    def test_each_step_runs_again_after_a_change_of_what_it_reads_and_only_then(self):
        names = {step.name for step in self.steps}
        self.assertEqual(self.run_all(), names)
        self.assertEqual(self.run_all(), set())
        for step in self.steps:
            path = self.read_by(step.name)
            (self.root / path).write_text(f"changed for {step.name}")
            ran = self.run_all()
            self.assertIn(step.name, ran, path)
            for other in self.steps:
                self.assertTrue(other.name in ran or not steps.is_read(other, path), f"{other.name} reads {path}")
                is_needed = any(other.name in later.after for later in self.steps if later.name in ran)
                self.assertTrue(other.name not in ran or steps.is_read(other, path) or other.makes and is_needed, other.name)
            self.assertEqual(self.run_all(), set(), path)
        self.assertEqual(self.run_all(everything=True), names)

    def test_another_compiler_and_another_command_run_steps_again(self):
        self.run_all()
        with mock.patch.object(proof, "machine", lambda: "another compiler"):
            self.assertEqual(self.run_all(), {step.name for step in self.steps})
        self.step("licences").command += " # and more"
        self.assertEqual(self.run_all(), {"licences"})

    def test_a_failure_stops_what_needs_the_step_and_nothing_else_and_proves_nothing(self):
        self.step("build").command = "exit 3"
        ran = self.run_all()
        lost = {
            "build", "unit", "documentation", "steps", "crates", "python", "try-arm64", "try-armhf", "guest-cases", "guest-console",
        }
        self.assertEqual(ran, {step.name for step in self.steps} - lost)
        self.assertEqual(steps.conclude(self.run_of_steps, [], 0.0), 1)
        self.assertIn("== FAILED: build,", self.said[-2])
        # What makes files for the lost steps runs again.
        self.assertEqual(self.run_all(), {"guest", "package-amd64", "package-arm64", "package-armhf"})
        self.assertEqual(self.run_of_steps.outcomes["build"].verdict, "FAILED")

    def test_what_is_skipped_is_listed_and_not_proven(self):
        self.step("guest").command = f"echo guest >>{self.ran}; echo it needs root; exit {steps.SKIPPED}"
        self.step("unit").command += '; echo "a test: it needs a camera" >>"$FACEWIRE_SKIPPED"'
        self.run_all()
        self.assertEqual(steps.conclude(self.run_of_steps, ["licences"], 0.0), 0)
        listed = self.said[-1].splitlines()
        cases = [f"step guest-{which}: it needs guest" for which in ("cases", "console", "packages", "shipped")]
        steps_left_out = ["step guest: it needs root", "step licences: not asked for"]
        self.assertEqual(listed, ["a test: it needs a camera", *cases, *steps_left_out])
        self.assertIn("== passed, 7 skipped", self.said[-2])
        self.assertEqual(self.run_all() & {"guest", "unit", "guest-cases"}, {"guest", "unit"})

    def test_the_tests_of_a_crate_run_again_after_a_change_of_what_it_reads_or_if_they_were_skipped(self):
        def place(package):
            return str(self.root / pathlib.Path(package["manifest_path"]).relative_to(ROOT))

        packages = {name: {**package, "manifest_path": place(package)} for name, package in proof.workspace(ROOT).items()}
        (self.root / "Cargo.toml").touch()
        tested = self.ran.with_name("tested")

        def run(*changed, skipped="true"):
            for path in changed:
                (self.root / path).parent.mkdir(parents=True, exist_ok=True)
                (self.root / path).write_text(f"{changed} {skipped}")
            tested.unlink(missing_ok=True)
            self.step("unit").command = f'echo "$FACEWIRE_STEPS_TESTS" >{tested}; {skipped}'
            self.run_all()
            return set(re.findall(r"package\(=(\S+)\)", tested.read_text()))

        with mock.patch.object(proof, "workspace", lambda _: packages):
            self.assertEqual(run("servo/src/lib.rs", "fit/src/lib.rs"), set(packages))
            self.assertEqual(run("docs/faults.md"), set())
            skips = 'echo "facewire_fit a test: it needs a video" >>"$FACEWIRE_SKIPPED"'
            self.assertEqual(run("fit/src/lib.rs", skipped=skips), {"facewire-fit"})
            self.assertLess({"facewire-servo", "facewire-fit"}, run("servo/src/lib.rs"))
            self.assertNotIn("facewire-packet", run("servo/src/lib.rs", "docs/faults.md"))
            self.run_all(everything=True)
            self.assertEqual(tested.read_text(), "all()\n")

    def commit(self, times):
        """Commits all changes, and makes `times` commits in all, the others of which are empty."""
        author = ["-c", "user.name=somebody", "-c", "user.email=somebody@localhost"]
        subprocess.run(["git", "add", "--all"], cwd=self.root, check=True)
        for _ in range(times):
            subprocess.run(["git", *author, "commit", "--quiet", "--allow-empty", "--message", "work"], cwd=self.root, check=True)

    def test_a_new_machine_leaves_settled_steps_to_all_unless_what_they_read_has_changed_in_the_latest_commits(self):
        names = {step.name for step in self.steps}
        settled = {step.name for step in self.steps if step.settled}
        # What makes files for steps that run does so, settled or not.
        left = settled - {name for step in self.steps if step.name not in settled for name in step.after}
        self.commit(steps.RECENT_COMMITS + 1)
        self.assertEqual(self.run_all(), names - left)
        self.assertEqual(steps.conclude(self.run_of_steps, [], 0.0), 0)
        named = re.findall(r"^step (\S+): left to --all", self.said[-1], re.MULTILINE)
        self.assertEqual(sorted(named), sorted(left))
        self.assertEqual(self.run_all(), set())
        # A change counts whether it is committed or not.
        changed = self.read_by("roots")
        (self.root / changed).write_text("changed")
        readers = {step.name for step in self.steps if steps.is_read(step, changed)}
        self.commit(1)
        self.assertEqual(readers - self.run_all(), set())
        (self.root / self.read_by("try-armhf")).write_text("changed again")
        self.assertLess({"try-armhf", "package-armhf"}, self.run_all())
        # So does a file that goes elsewhere.
        moved = self.root / self.read_by("wheel")
        moved.rename(self.root / "elsewhere")
        self.commit(1)
        self.assertIn("wheel", self.run_all())
        # Once such a step has run on this machine, it runs whenever what it reads has changed since then.
        self.commit(steps.RECENT_COMMITS + 1)
        with mock.patch.object(proof, "machine", lambda: "another compiler"):
            self.assertLess({"roots", "try-armhf"}, self.run_all())

    def test_a_settled_step_that_has_failed_or_whose_command_has_changed_is_not_left_out(self):
        described = self.root / steps.LIST
        described.parent.mkdir(parents=True, exist_ok=True)
        described.write_text((ROOT / steps.LIST).read_text().replace('command = "packaging/roots"', 'command = "packaging/roots old"'))
        self.commit(steps.RECENT_COMMITS + 1)
        self.steps = steps.load(ROOT / steps.LIST)
        self.assertIn("roots", steps.settled(self.root, self.steps))
        described.write_text((ROOT / steps.LIST).read_text())
        left = steps.settled(self.root, self.steps)
        self.assertNotIn("roots", left)
        self.assertIn("try-arm64", left)
        step_of_roots = next(part for part in described.read_text().split("[[step]]") if 'name = "roots"' in part)
        described.write_text(described.read_text().replace(f"[[step]]{step_of_roots}", ""))
        self.commit(steps.RECENT_COMMITS + 1)
        described.write_text((ROOT / steps.LIST).read_text())
        self.assertNotIn("roots", steps.settled(self.root, self.steps), "a new step is not left out")
        proof.prove(proof.failure("try-arm64"))
        self.assertEqual(left - steps.settled(self.root, self.steps), {"try-arm64"})

    def test_what_a_step_waits_for_makes_files_or_is_not_settled(self):
        for step in self.steps:
            for name in step.after:
                self.assertTrue(self.step(name).makes or not self.step(name).settled, name)

    def test_settled_steps_that_are_asked_for_run(self):
        self.commit(steps.RECENT_COMMITS + 1)
        folder = pathlib.Path(tempfile.mkdtemp(dir=self.ran.parent))
        self.steps = steps.chosen(self.steps, ["package"])
        steps.test(self.root, self.steps, folder, everything=False, asked=["package"])
        self.assertEqual(set(self.ran.read_text().split()), {step.name for step in self.steps})
        self.assertIn("roots", self.ran.read_text().split())

    def test_under_ci_a_step_may_not_skip_itself(self):
        self.step("guest").command = f"echo it needs root; exit {steps.SKIPPED}"
        with mock.patch.dict(os.environ, {"CI": "true"}):
            self.run_all()
        self.assertEqual(self.run_of_steps.outcomes["guest"].verdict, "FAILED")
        self.assertEqual(steps.conclude(self.run_of_steps, [], 0.0), 1)

    def test_a_file_that_changes_while_a_step_runs_proves_nothing(self):
        self.step("licences").command += f"; echo changed >>{self.root}/{self.read_by('licences')}"
        self.run_all()
        self.assertIn("licences", self.run_all())

    def test_a_file_that_may_be_executed_no_more_is_another_file(self):
        self.run_all()
        path = self.root / self.read_by("package-amd64")
        path.chmod(0o755)
        self.assertIn("package-amd64", self.run_all())
        self.assertNotIn("package-amd64", self.run_all())
        path.chmod(0o644)
        # It is proven from before.
        self.assertNotIn("package-amd64", self.run_all())

    def test_variables_for_the_compiler_run_steps_again(self):
        with mock.patch.dict(os.environ, {"RUSTFLAGS": "", "LANG": "C"}):
            before = MACHINE()
        with mock.patch.dict(os.environ, {"RUSTFLAGS": "", "LANG": "de_DE"}):
            self.assertEqual(MACHINE(), before)
        with mock.patch.dict(os.environ, {"RUSTFLAGS": "-g"}):
            self.assertNotEqual(MACHINE(), before)

    def test_steps_of_one_lane_run_one_after_the_other(self):
        for step in self.steps:
            step.command = f"mkdir {self.root}.lane-{step.lane}; rmdir {self.root}.lane-{step.lane}" if step.lane else "true"
        self.run_all()
        self.assertEqual({outcome.verdict for outcome in self.run_of_steps.outcomes.values()}, {"passed"})


    def test_only_steps_whose_tests_follow_a_clock_keep_their_priority(self):
        for step in self.steps:
            step.command = f"test $(nice) = {min(19, os.nice(0) + (0 if step.clocked else steps.PATIENT_NICENESS))}"
        self.run_all()
        self.assertEqual({outcome.verdict for outcome in self.run_of_steps.outcomes.values()}, {"passed"})
        clocked = {"unit", "python", "guest-cases", "guest-console", "guest-packages", "guest-shipped"}
        self.assertEqual({step.name for step in self.steps if step.clocked}, clocked)


class Crates(unittest.TestCase):
    """The step unit and scripts/test quick test the crates that a change can break."""

    def setUp(self):
        self.packages = proof.workspace(ROOT)
        self.contents = dict.fromkeys(proof.files(ROOT), "as it was")

    def changed(self, path, *what):
        """Returns the crates whose stamps another content of the file changes."""
        before, after = (
            proof.crate_stamps(ROOT, self.packages, "", contents, *what)
            for contents in (self.contents, {**self.contents, path: "changed"})
        )
        return {name.removeprefix("facewire-") for name in self.packages if before[name] != after[name]}

    def test_a_change_leads_to_tests_of_its_crate_and_of_all_that_use_it_in_any_way(self):
        every = {name.removeprefix("facewire-") for name in self.packages}
        for path, crates in (
            ("Cargo.lock", every),
            ("tests/common/mod.rs", every),
            ("packet/src/lib.rs", every - {"engine", "board"}),
            ("src/pipeline.rs", {"facewire", "tools", "fit", "console", "library", "c", "python"}),
            # The console's tests operate the service, and those of the service start the tools.
            ("tools/src/track.rs", {"tools", "facewire", "fit", "console", "library", "c", "python"}),
            ("src/capture/jpeg/tests.rs", {"facewire"}),
            ("tests/service.rs", {"facewire"}),
            ("servo/src/bus/tests.rs", {"servo"}),
            ("console/page/app.js", {"console"}),
            ("console/tests/page.rs", {"console"}),
            ("fit/src/train.rs", {"fit"}),
            ("library/tests/common/films.rs", every),
            ("bridge/README.md", {"bridge"}),
            ("docs/receivers.md", {"facewire"}),
            # The tests that read documents always run.
            ("docs/faults.md", set()),
            ("scripts/setup", set()),
        ):
            self.assertEqual(self.changed(path), crates, path)

    def test_quick_tests_what_is_built_from_the_changed_crate_and_lints_that_crate_alone(self):
        for path, tested, linted in (
            ("servo/src/lib.rs", {"servo", "facewire", "tools", "fit"}, {"servo"}),
            ("models/blendshapes.toml", {"face", "facewire", "tools", "fit", "library", "c", "python"}, {"face"}),
            ("src/pipeline.rs", {"facewire", "tools", "fit"}, {"facewire"}),
            ("tests/service.rs", {"facewire"}, {"facewire"}),
            ("console/page/app.js", {"console"}, {"console"}),
        ):
            self.assertEqual(self.changed(path, "quick-", proof.with_libraries), tested, path)
            self.assertEqual(self.changed(path, "clippy-", lambda _, name: {name}), linted, path)

    def test_quick_leaves_out_the_longest_tests_and_names_them(self):
        names = {"facewire", "facewire-library"}
        chosen = {option.partition("=")[2] for option in quick.targets(self.packages, names)}
        # The tests of the service start the tools, too.
        self.assertTrue(chosen >= {"service", "tracker", "facewire-tools", *proof.READS_ALL}, chosen)
        self.assertFalse(chosen & set(quick.LONG))
        self.assertEqual(quick.left_out(self.packages, names), ["calibrate", "golden", "impairments", "memory", "overload", "soak"])
        known = {target["name"] for package in self.packages.values() for target in package["targets"]}
        self.assertTrue(known >= {*quick.LONG, *proof.READS_ALL})

    def test_quick_leaves_out_what_needs_features_that_are_not_asked_for(self):
        chosen = quick.targets(self.packages, set(self.packages))
        needs = [target for package in self.packages.values() for target in package["targets"] if target.get("required-features")]
        self.assertTrue(needs)
        self.assertFalse({f"--test={target['name']}" for target in needs} & set(chosen))
        self.assertIn("zenoh", quick.left_out(self.packages, set(self.packages)))


class Guests(unittest.TestCase):
    """The cases of the device tests run after a change of what they are about."""

    def test_each_case_belongs_to_a_step_and_those_in_tables_of_faults_to_the_one_that_follows_what_meets_the_kernel(self):
        known = {step.name: step for step in steps.load(pathlib.Path(__file__).with_name("steps.toml"))}
        cases = {path.stem for path in (ROOT / "tests/guest/cases").glob("*.sh")} - {"lib", "package"}
        runs = {name: self.cases_of(known[name]) for name in ("guest-cases", "guest-packages", "guest-console")}
        self.assertEqual(sorted(case for names in runs.values() for case in names), sorted([*cases, "console"]))
        tables = "".join((ROOT / table).read_text() for table in ("docs/faults.md", "docs/security.md"))
        named = set(re.findall(r"`(\w+)\.sh`", tables))
        self.assertGreater(len(named), 5)
        self.assertEqual(named - set(runs["guest-cases"]), set())
        self.assertEqual(self.cases_of(known["guest-shipped"]), runs["guest-cases"])
        kernel = (
            "board/src/lib.rs", "servo/src/pca9685.rs", "src/capture/v4l2/mod.rs", "src/link/bus_servo.rs",
            "src/link/serial.rs", "src/service/hot.rs",
        )
        for name, paths in (
            ("guest-cases", (*kernel, "systemd/facewire.service")),
            ("guest-shipped", ("systemd/facewire.service", "packaging/scripts/prerm", "cross/common.sh")),
        ):
            for path in paths:
                self.assertTrue((ROOT / path).exists(), path)
                self.assertTrue(steps.is_read(known[name], path), path)
        console = ("page/start.js", "src/console.rs", "src/program.rs", "src/settings.rs", "tests/guest.rs")
        for path in (*(f"console/{name}" for name in console), "src/service/control/client.rs", "systemd/facewire-helper"):
            self.assertTrue((ROOT / path).exists(), path)
            self.assertTrue(steps.is_read(known["guest-console"], path), path)
        for name, cases in {**runs, "guest-shipped": runs["guest-cases"]}.items():
            for case in cases:
                self.assertTrue(steps.is_read(known[name], f"tests/guest/cases/{case}.sh") or case == "console", case)

    def cases_of(self, step):
        """Returns the cases that a step runs, as tests/guest/run lists them."""
        command = step.command.replace("tests/guest/run", "tests/guest/run --list")
        return subprocess.run(["bash", "-c", command], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.split()


class Sources(unittest.TestCase):
    """The patterns in steps.toml cover every source file that, according to cargo, the programs are built from."""

    def test_the_steps_that_run_programs_read_all_their_sources(self):
        everywhere = ("programs-arm64", "instructions", "arm64-kernel", "armv7", "python", "unit")
        programs = {
            "facewire": everywhere,
            "facewire-tools": everywhere,
            "facewire-console": ("unit",),
            "facewire-bridge": ("guest-packages", "unit"),
            "facewire-face": ("arm64", "crates", "oldest-rust"),
            "facewire-python": ("python", "unit"),
            "facewire-c": ("unit",),
        }
        known = {step.name: step for step in steps.load(pathlib.Path(__file__).with_name("steps.toml"))}
        packages = proof.workspace(ROOT)
        for program, names in programs.items():
            sources = {source for crate in with_dependencies(packages, program) for source in sources_of(packages[crate])}
            self.assertGreater(len(sources), 20, program)
            for name in names:
                unread = [path for path in sorted(sources) if not steps.is_read(known[name], path)]
                self.assertEqual(unread, [], f"{name} runs {program}")


def with_dependencies(packages, name):
    """Returns the package and the packages of the workspace that it depends on."""
    needed = {found["name"] for found in packages[name]["dependencies"] if found["kind"] != "dev"} & packages.keys()
    return {name}.union(*(with_dependencies(packages, other) for other in needed))


def sources_of(package):
    """Returns the files of this checkout that cargo lists as those of a crate, when it is compiled for programs."""
    crate = package["name"].replace("-", "_")
    folder = pathlib.Path(package["manifest_path"]).parent
    lists = list((steps.target_folder() / "debug" / "deps").glob(f"{crate}-*.d"))
    # `cargo package` compiles copies of crates, and names their files as if they were those of this folder.
    lists = [path for path in lists if any(source.is_relative_to(folder) for source in sources_in(path))]
    # Lists of a library's unit tests name more files. They belong to a program or, if clippy made them, to no code.
    libraries = [path for path in lists if path.with_name(f"lib{path.stem}.rlib").exists()]
    found = set()
    for path in libraries or lists:
        found |= {str(path.relative_to(ROOT)) for path in sources_in(path) if path.is_relative_to(ROOT) and path.exists()}
    # clippy.toml is a source of clippy's own.
    return {path for path in found if path != "clippy.toml" and not path.startswith("target/")}


def sources_in(path):
    """Returns the files in one of cargo's lists."""
    names = path.read_text().splitlines()[0].partition(":")[2].split()
    return [(ROOT / name).resolve() for name in names]


class Compiled(unittest.TestCase):
    """Crates of a registry are compiled once for all checkouts."""

    def test_another_checkout_compiles_its_own_crate_alone(self):
        with tempfile.TemporaryDirectory() as folder:
            cache = pathlib.Path(folder) / "cache"
            said = [self.build(pathlib.Path(folder) / name, cache) for name in ("first", "second")]
        self.assertEqual(set(re.findall(r"Compiling (\S+)", said[0])), {"cfg-if", "facewire-of-a-test"})
        self.assertEqual(set(re.findall(r"Compiling (\S+)", said[1])), {"facewire-of-a-test"})

    def test_packages_of_another_commit_compile_no_registry_crate_again(self):
        """A crate with C code is compiled again at another time of the source, and so is all that uses it."""
        with tempfile.TemporaryDirectory() as folder:
            cargo = pathlib.Path(folder) / "cargo"
            cargo.write_text('#!/bin/sh\necho "$1 ${SOURCE_DATE_EPOCH-unset}"\n')
            cargo.chmod(0o755)
            command = ["bash", "-c", "source cross/common.sh; build_programs ''"]
            said = {
                subprocess.run(
                    command, cwd=ROOT, check=True, stdout=subprocess.PIPE,
                    env={**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "SOURCE_DATE_EPOCH": time_of_commit},
                ).stdout
                for time_of_commit in ("1700000000", "1800000000")
            }
        self.assertEqual(said, {b"build 0\n" * 3})

    def test_what_an_interrupted_run_has_kept_does_no_harm(self):
        with tempfile.TemporaryDirectory() as folder:
            cache = pathlib.Path(folder) / "cache"
            (cache / "compiled" / "debug" / ".fingerprint" / "cfg-if-0123456789abcdef").mkdir(parents=True)
            said = self.build(pathlib.Path(folder) / "checkout", cache)
        self.assertEqual(set(re.findall(r"Compiling (\S+)", said)), {"cfg-if", "facewire-of-a-test"})

    def test_a_profile_that_cargo_builds_is_left_alone(self):
        with tempfile.TemporaryDirectory() as folder:
            source, target = self.compiled(folder, "source", "a"), pathlib.Path(folder) / "target"
            with (source / "debug/.cargo-lock").open("a") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                compiled.copy(source, target)
            self.assertFalse(target.exists())
            compiled.copy(source, target)
            self.assertTrue((target / self.crate("a")).exists())

    def test_crates_that_were_compiled_with_others_are_not_mixed(self):
        with tempfile.TemporaryDirectory() as folder:
            source, target = self.compiled(folder, "source", "ab"), self.compiled(folder, "target", "a")
            (target / self.crate("a")).write_text("the same crate of another checkout")
            compiled.copy(source, target)
            self.assertFalse((target / self.crate("b")).exists())
            (target / self.crate("a")).write_text("source")
            (source / self.crate("a")).write_text("source")
            compiled.copy(source, target)
            self.assertTrue((target / self.crate("b")).exists())

    def crate(self, letter):
        """Returns the path of a compiled crate in a target folder."""
        return f"debug/deps/lib{letter}-{letter * 16}.rlib"

    def compiled(self, folder, name, letters):
        """Makes a target folder with crates of these letters. Returns its path."""
        target = pathlib.Path(folder) / name
        for letter in letters:
            for path in (self.crate(letter), f"debug/.fingerprint/{letter}-{letter * 16}/lib-{letter}", "debug/.cargo-lock"):
                (target / path).parent.mkdir(parents=True, exist_ok=True)
                (target / path).touch()
        return target

    def build(self, checkout, cache):
        """Makes a checkout of a small project and builds it. Returns what cargo says."""
        (checkout / "src").mkdir(parents=True)
        (checkout / "src" / "lib.rs").write_text("cfg_if::cfg_if! { if #[cfg(unix)] { pub fn unix() {} } }\n")
        version = re.search(r'name = "cfg-if"\nversion = "(.*)"', (ROOT / "Cargo.lock").read_text())[1]
        (checkout / "Cargo.toml").write_text(
            f'[package]\nname = "facewire-of-a-test"\nedition = "2024"\n[dependencies]\ncfg-if = "={version}"\n[workspace]\n'
        )
        target = checkout / "target"
        compiled.take(cache, target)
        command = ["cargo", "build", "--offline", "--target-dir", str(target)]
        said = subprocess.run(command, cwd=checkout, check=True, stderr=subprocess.PIPE, text=True).stderr
        compiled.give(cache, target)
        return said


if __name__ == "__main__":
    unittest.main()
