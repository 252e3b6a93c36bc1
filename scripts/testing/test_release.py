"""scripts/release refuses in seconds what could not be released, and otherwise puts everything into one folder. Stand-ins
replace the programs that build."""

import os
import pathlib
import shutil
import subprocess
import tarfile
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
CHANGELOG = """# Changelog

## Unreleased

- Not yet.

## [1.2.3] - 2026-01-02

### Added

- A face.

## 1.2.2

- Older.
"""
# What each program of the release does in place of building. The first line of all says that it ran.
STAND_INS = {
    "scripts/setup": "",
    "cross/setup": "",
    "scripts/package": """
        for name in facewire facewire-bridge libfacewire0 libfacewire-dev; do
            for debian in amd64 arm64 armhf; do
                mkdir -p target/packages
                echo "$name" >"target/packages/${name}_$(version_of_commit)-1_$debian.deb"
            done
        done""",
    "scripts/wheel": """
        mkdir -p target/wheels
        for architecture in x86_64 aarch64 armv7l; do
            echo old >"target/wheels/facewire-1.2.3-old_$architecture.whl"
            touch --date=@1 "target/wheels/facewire-1.2.3-old_$architecture.whl"
            echo new >"target/wheels/facewire-1.2.3-new_$architecture.whl"
        done""",
    "bin/cargo": """
        if [[ $1 == metadata ]]; then exec cat lock >/dev/null; fi
        mkdir -p target/package
        for word in "$@"; do
            [[ $word != facewire-* ]] || echo "$word" >"target/package/$word-1.2.3.crate"
        done""",
    "bin/rustc": "echo rustc 1.92.0 '(ded5c06cf 2025-12-08)'",
    "bin/dpkg": "echo amd64",
    "bin/getconf": "echo glibc 2.36",
}
NAMES = ("facewire", "facewire-bridge", "libfacewire0", "libfacewire-dev")
DEBIAN = [f"{name}_1.2.3-1_{of}.deb" for name in NAMES for of in ("amd64", "arm64", "armhf")]
WHEELS = [f"facewire-1.2.3-new_{of}.whl" for of in ("x86_64", "aarch64", "armv7l")]
CRATES = [f"facewire-{name}-1.2.3.crate" for name in ("packet", "engine", "face", "library")]
PUBLISHED = {*DEBIAN, *WHEELS, *CRATES, "facewire-1.2.3.tar.gz", "release-notes.md", "SHA256SUMS"}


class Release(unittest.TestCase):
    """A checkout with the real script and a tag."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name) / "checkout"
        self.programs = pathlib.Path(folder.name) / "bin"
        self.ran = pathlib.Path(folder.name) / "ran"
        for path in ("scripts/release", "scripts/waiting.sh", "cross/common.sh"):
            (self.root / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, self.root / path)
        for path, commands in STAND_INS.items():
            self.stand_in(path, commands)
        self.write("Cargo.toml", '[workspace.package]\nversion = "1.2.3"\nrust-version = "1.92"\n')
        self.write("CHANGELOG.md", CHANGELOG)
        self.write("lock", "")
        self.write(".gitignore", "/target\n")
        self.git("init", "--quiet")
        self.commit()
        self.git("tag", "v1.2.3")

    def write(self, path, text):
        (self.root / path).write_text(text)

    def stand_in(self, path, commands):
        """Writes a program into the checkout, or into the folder that is searched first."""
        file = self.programs / path.removeprefix("bin/") if path.startswith("bin/") else self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        note = f'echo "{path} $*" >>{self.ran}'
        file.write_text(f"#!/bin/bash\n{note}\nsource cross/common.sh\nset -e\n{commands}\n")
        file.chmod(0o755)

    def git(self, *arguments):
        subprocess.run(["git", *arguments], cwd=self.root, env=self.environment(), stdout=subprocess.DEVNULL, check=True)

    def environment(self):
        who = {f"GIT_{role}_{what}": "a@b.invalid" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        when = {"GIT_AUTHOR_DATE": "@1767312000 +0000", "GIT_COMMITTER_DATE": "@1767312000 +0000"}
        own = {"GIT_CONFIG_GLOBAL": "/dev/null", "PATH": f"{self.programs}:{os.environ['PATH']}"}
        kept = {name: value for name, value in os.environ.items() if name not in ("CARGO_TARGET_DIR", "PACKAGE_COMMON")}
        return {**kept, **who, **when, **own}

    def commit(self):
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", "a change")

    def release(self, *arguments, **variables):
        """Runs scripts/release. Returns the completed process."""
        self.ran.write_text("")
        command = ["scripts/release", *arguments]
        return subprocess.run(command, cwd=self.root, env={**self.environment(), **variables}, capture_output=True, text=True)

    def assert_refused(self, sentence, *arguments):
        """Both a release and a check are refused with this sentence, and nothing was built or set up."""
        for more in ([], ["--check"]):
            run = self.release(*arguments, *more)
            self.assertEqual(run.returncode, 1, run)
            self.assertIn(f"release: {sentence}", run.stderr)
            self.assertEqual(run.stdout, "")
            self.assertEqual(set(self.ran.read_text().split()) & {"package", "scripts/package", "scripts/setup"}, set())

    def test_everything_of_a_tagged_commit_is_in_one_folder_with_its_sums(self):
        run = self.release()
        self.assertEqual((run.returncode, run.stderr), (0, ""))
        folder = self.root / "target/release-1.2.3"
        self.assertEqual({path.name for path in folder.iterdir()}, PUBLISHED)
        subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=folder, check=True)
        self.assertEqual(len((folder / "SHA256SUMS").read_text().splitlines()), len(PUBLISHED) - 1)
        self.assertEqual((folder / "release-notes.md").read_text(), "### Added\n\n- A face.\n")
        with tarfile.open(folder / "facewire-1.2.3.tar.gz") as sources:
            self.assertIn("facewire-1.2.3/scripts/release", sources.getnames())
        self.assertEqual({path.name for path in (self.root / "target").glob("*release*")}, {"release-1.2.3"})

    def test_a_clone_with_other_habits_makes_the_same_bytes(self):
        self.release()
        sums = (self.root / "target/release-1.2.3/SHA256SUMS").read_text()
        clone = self.root.with_name("another")
        subprocess.run(["git", "clone", "--quiet", str(self.root), str(clone)], check=True)
        self.root = clone
        self.git("config", "tar.umask", "0077")
        run = self.release(LC_ALL="C.UTF-8", TZ="Pacific/Chatham", SOURCE_DATE_EPOCH="1", PACKAGE_VERSION="7")
        self.assertEqual(run.returncode, 0, run)
        self.assertEqual((clone / "target/release-1.2.3/SHA256SUMS").read_text(), sums)

    def test_a_check_makes_nothing(self):
        run = self.release("--check")
        self.assertEqual((run.returncode, run.stdout), (0, "release: 1.2.3: a release can be made\n"))
        self.assertEqual(list((self.root / "target").iterdir()), [])
        self.assertNotIn("setup", self.ran.read_text())

    def test_a_commit_without_the_tag_is_refused_but_for_a_trial(self):
        self.git("tag", "--delete", "v1.2.3")
        remedy = "git tag --annotate v1.2.3. For a trial release: scripts/release --untagged"
        self.assert_refused(f"this commit has no tag v1.2.3: {remedy}\n")
        run = self.release("--untagged")
        self.assertEqual(run.returncode, 0, run)
        (folder,) = (self.root / "target").glob("release-*")
        self.assertRegex(folder.name, r"^release-1\.2\.3~20260102000000\.[0-9a-f]{8}$")
        self.assertEqual(len(list(folder.iterdir())), len(PUBLISHED))
        self.assertEqual((folder / "release-notes.md").read_text(), "### Added\n\n- A face.\n")

    def test_a_trial_before_the_version_has_a_heading_takes_what_is_unreleased(self):
        self.git("tag", "--delete", "v1.2.3")
        self.write("Cargo.toml", '[workspace.package]\nversion = "1.3.0"\n')
        self.stand_in("bin/cargo", STAND_INS["bin/cargo"].replace("1.2.3", "1.3.0"))
        self.commit()
        run = self.release("--untagged")
        self.assertEqual(run.returncode, 0, run)
        (folder,) = (self.root / "target").glob("release-*")
        self.assertEqual((folder / "release-notes.md").read_text(), "- Not yet.\n")

    def test_a_tag_of_another_version_is_refused_even_for_a_trial(self):
        self.write("Cargo.toml", '[workspace.package]\nversion = "1.2.4"\n')
        self.commit()
        self.git("tag", "v1.3.0")
        sentence = "this commit has the tag v1.3.0, but the version in Cargo.toml is 1.2.4: set it to 1.3.0, commit, and move"
        self.assert_refused(sentence)
        self.assert_refused(sentence, "--untagged")

    def test_a_tag_at_another_commit_is_named(self):
        self.write("lock", "changed")
        self.commit()
        self.assert_refused("the tag v1.2.3 is at another commit: git checkout v1.2.3, or set a new version in Cargo.toml\n")

    def test_local_changes_are_refused_and_the_first_is_named(self):
        self.write("new", "")
        self.assert_refused("the tree has local changes, such as new: commit them, or remove them\n")
        (self.root / "new").unlink()
        self.write("CHANGELOG.md", CHANGELOG + "- More.\n")
        self.assert_refused("the tree has local changes, such as CHANGELOG.md: commit them, or remove them\n", "--untagged")

    def test_a_folder_without_git_is_refused(self):
        shutil.rmtree(self.root / ".git")
        self.assert_refused("this folder is no git checkout, and a release is made from a commit: clone the repository\n")

    def test_a_version_of_which_the_changelog_says_nothing_is_refused(self):
        for text in (CHANGELOG.replace("[1.2.3]", "1.2.30"), CHANGELOG.replace("### Added\n\n- A face.\n", "")):
            self.write("CHANGELOG.md", text)
            self.commit()
            self.git("tag", "--force", "v1.2.3")
            remedy = "write a heading '## 1.2.3 - DATE' over its changes, and commit"
            self.assert_refused(f"CHANGELOG.md says nothing about 1.2.3: {remedy}\n")

    def test_versions_that_cargo_refuses_are_found_before_anything_is_built(self):
        self.stand_in("bin/cargo", "echo 'error: cannot update the lock file' >&2; exit 101")
        remedy = "run cargo check, and commit Cargo.lock. Cargo says:\nerror: cannot update the lock file\n"
        self.assert_refused(f"Cargo.lock does not fit the versions in the files Cargo.toml: {remedy}")

    def test_a_full_disk_is_found_before_anything_is_built(self):
        self.stand_in("bin/df", "echo Avail; echo 7999999999")
        self.assert_refused(f"{self.root}/target has 7 GB of free space, but a release needs 8 GB: free some, or name")

    def test_a_release_that_is_there_stays(self):
        folder = self.root / "target/release-1.2.3"
        folder.mkdir(parents=True)
        self.assert_refused(f"{folder} is there: move it away to compare the new one with it, or remove it\n")

    def test_a_missing_tool_and_another_kind_of_pc_are_named(self):
        self.stand_in("bin/dpkg", "echo arm64")
        self.assert_refused("this works on amd64 PCs with Debian or a relative of it\n")
        (self.programs / "dpkg").unlink()
        for tool in ("awk", "bash", "dirname", "env", "git", "gzip", "python3", "realpath", "sed", "sha256sum", "sort"):
            (self.programs / tool).symlink_to(shutil.which(tool))
        run = self.release(PATH=str(self.programs))
        self.assertEqual((run.returncode, run.stderr), (1, "release: dpkg is missing: install it, and try again\n"))

    def test_a_newer_c_library_and_an_older_rust_are_found_before_anything_is_built(self):
        self.stand_in("bin/rustc", "echo rustc 1.91.1")
        self.assert_refused("this needs Rust 1.92 or later, and this is 1.91.1: rustup update\n")
        self.stand_in("bin/rustc", "echo rustc 1.100.0")
        for version, is_refused in (("2.31", False), ("2.37", True), ("2.100", True)):
            self.stand_in("bin/getconf", f"echo glibc {version}")
            run = self.release("--check")
            sentence = f"this PC has the C library glibc {version}, and programs built with it may not run on Debian 12"
            self.assertEqual(sentence in run.stderr, is_refused, run)

    def test_a_build_that_fails_leaves_nothing_half_made(self):
        self.stand_in("scripts/wheel", "fail 'no wheel'")
        self.commit()
        self.git("tag", "--force", "v1.2.3")
        run = self.release()
        self.assertEqual(run.returncode, 1)
        self.assertEqual(list((self.root / "target").glob("*release*")), [])

    def test_help_has_examples_and_another_argument_is_refused(self):
        run = self.release("--help")
        self.assertEqual((run.returncode, run.stderr), (0, ""))
        self.assertIn("Examples:\n", run.stdout)
        self.assertEqual(self.release("--untaged").returncode, 2)


if __name__ == "__main__":
    unittest.main()
