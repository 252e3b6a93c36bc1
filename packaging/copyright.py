#!/usr/bin/env python3
"""Writes the Debian copyright file (DEP-5) of a package for one Rust target to standard output.

copyright.py PACKAGE TARGET [CARGO-OPTION]...

packaging/copyright and packaging/*/copyright name the works that are no Rust packages. For every Rust package that is linked
into a program or library, this adds its licence and its copyright holders. Where a package offers several licences, it is
distributed under the first of PREFERRED that it offers. A package whose licence is not known here ends the script: add the
licence then.
"""

import json
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
# The crates that each Debian package is made of, and the file that its copyright begins with.
PACKAGES = {"facewire": (["facewire", "facewire-tools", "facewire-console"], "copyright"),
            "facewire-bridge": (["facewire-bridge"], "bridge/copyright"),
            "facewire-c": (["facewire-c"], "c/copyright")}
# Licences by their names in Cargo.toml, with Debian's names for them.
PREFERRED = {"MIT": "Expat", "Apache-2.0": "Apache-2.0", "MPL-2.0": "MPL-2.0", "ISC": "ISC",
             "BSD-3-Clause": "BSD-3-clause-of-holders", "IJG": "IJG"}
COMMON = "On Debian systems the full text is in /usr/share/common-licenses/{}."
COPYRIGHT = re.compile(r"^\W*copyright\s*(?:\(c\)|©)?\s*((?:[0-9]+[^\w\n]+|the ).*?)[\s.,;]*$", re.IGNORECASE | re.MULTILINE)
# Holders of the texts of licences themselves.
OF_TEXTS = re.compile(r"\[yyyy\]|\{|Free Software Foundation|the copyright", re.IGNORECASE)


def fail(message):
    """Ends the script."""
    sys.exit(f"copyright.py: {message}")


def cargo(*arguments):
    """Runs cargo and returns what it prints."""
    return subprocess.run(["cargo", *arguments, "--locked"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def linked_packages(programs, target, options):
    """Returns the packages whose code is in a program, sorted by name: those that the programs depend on when they run."""
    linked = set()
    for program in programs:
        tree = cargo("tree", f"--package={program}", "--edges=normal,no-proc-macro", f"--target={target}", "--prefix=none",
                     "--format={p}", *options)
        # A line is a name, a version, and remarks in brackets.
        linked |= {tuple(line.split(" ")[:2]) for line in tree.splitlines() if line}
    found = json.loads(cargo("metadata", "--format-version=1", f"--filter-platform={target}"))["packages"]
    packages = [one for one in found if one["source"] and (one["name"], "v" + one["version"]) in linked]
    return sorted(packages, key=lambda package: (package["name"], package["version"]))


def licence_of(package):
    """Returns Debian's name of the licence under which the package is distributed. Several may hold for its parts."""
    names = []
    for part in re.sub(r"[()]", "", package["license"] or "").split(" AND "):
        offered = re.split(r"\s+OR\s+|/", part.strip())
        names += [debian for name, debian in PREFERRED.items() if name in offered][:1] or [
            fail(f"{package['name']} has the licence {package['license']!r}: add it to PREFERRED, with its text")]
    return " and ".join(dict.fromkeys(names))


def files_of(package, *patterns):
    """Returns the files in the package's folder that match, sorted by name."""
    folder = pathlib.Path(package["manifest_path"]).parent
    return [path for pattern in patterns for path in sorted(folder.glob(pattern)) if path.is_file()]


def holders_of(package):
    """Returns the copyright holders, from the licence files, else from the authors, one per line."""
    texts = [path.read_text("utf-8", "replace") for path in files_of(package, "LICEN[SC]E*", "COPYRIGHT*", "license*")]
    found = [line.strip() for text in texts for line in COPYRIGHT.findall(text) if not OF_TEXTS.search(line)]
    names = found or [re.sub(r"\s*<.*?>", "", author) for author in package["authors"]]
    return list(dict.fromkeys(names)) or [f"The authors of {package['name']}"]


def paragraph(*fields):
    """Writes a paragraph. A field with several lines continues below its name."""
    return "\n".join(f"{name}: " + "\n ".join(lines) for name, lines in fields) + "\n"


def licence_paragraph(name, text):
    """Writes the text of a licence."""
    lines = [line.strip().replace("\t", " ") or "." for line in text.strip().splitlines()]
    return paragraph(("License", [name, *lines]))


def section(text, first, last):
    """Returns the part of a text from one line to before another one."""
    begin = text.find(first)
    end = text.find(last, begin) if last else len(text)
    if begin < 0 or end < 0:
        fail(f"no text from {first!r} to {last!r}: adapt this script")
    return text[begin:end]


def texts(packages):
    """Returns the texts of all licences by their names in Debian."""
    by_name = {package["name"]: package for package in packages}
    found = {"Expat": section((ROOT / "LICENSE-MIT").read_text("utf-8"), "Permission is", None)}
    if "turbojpeg-sys" in by_name:
        (jpeg,) = files_of(by_name["turbojpeg-sys"], "libjpeg-turbo/LICENSE.md")
        (ijg,) = files_of(by_name["turbojpeg-sys"], "libjpeg-turbo/README.ijg")
        found["BSD-3-clause"] = section(jpeg.read_text("utf-8"), "Redistribution and use", "Why Two Licenses")
        legal = ijg.read_text("utf-8").split("LEGAL ISSUES\n============")[1]
        found["IJG"] = section(legal, "In plain English", "REFERENCES")
    for name in ("Apache-2.0", "MPL-2.0", "GPL-3"):
        found[name] = COMMON.format(name)
    for name, first, end in (("ISC", "Permission to use", "OF THIS SOFTWARE."), ("BSD-3-clause-of-holders", "Redistribution and use", "\0")):
        of_name = [package for package in packages if name in licence_of(package).split(" and ")]
        found_texts = {}
        for package in of_name:
            # Some texts stand in comments.
            files = [re.sub("^// ?", "", file.read_text("utf-8"), flags=re.MULTILINE) for file in files_of(package, "LICENSE*")]
            text = section(next(text for text in files if first in text), first, None)
            if end in text:
                text = section(text, first, end) + end
            # One author or several are no difference.
            found_texts[re.sub(r"AUTHORS? (DISCLAIM|BE)S?", r"AUTHOR \1", " ".join(text.split()))] = text
        if len(found_texts) > 1:
            fail(f"the texts of {name} differ: give each a name of its own")
        found.update((name, text) for text in found_texts.values())
    return found


def main():
    """Writes the file."""
    if len(sys.argv) < 3 or sys.argv[1] not in PACKAGES:
        fail("usage: copyright.py PACKAGE TARGET [CARGO-OPTION]...")
    programs, beginning = PACKAGES[sys.argv[1]]
    packages = linked_packages(programs, sys.argv[2], sys.argv[3:])
    parts = [(ROOT / "packaging" / beginning).read_text("utf-8")]
    for package in packages:
        fields = [
            ("Files", [f"rust/{package['name']}-{package['version']}/*"]),
            ("Copyright", holders_of(package)),
            ("License", [licence_of(package)]),
        ]
        if package["repository"]:
            fields.append(("Comment", [f"Linked into a program or library. Source: {package['repository']}"]))
        parts.append(paragraph(*fields))
    used = set(re.findall(r"^License: (.*)$", "\n".join(parts), re.MULTILINE))
    used = {name for names in used for name in re.split(r" or | and ", names)}
    known = texts(packages)
    parts += [licence_paragraph(name, known[name]) for name in sorted(used)]
    print("\n".join(parts), end="")


if __name__ == "__main__":
    main()
