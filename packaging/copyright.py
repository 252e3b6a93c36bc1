#!/usr/bin/env python3
"""Writes the Debian copyright file (DEP-5) of the package for one Rust target to standard output.

copyright.py TARGET [CARGO-OPTION]...

packaging/copyright names the works that are no Rust packages. For every Rust package that is linked into a program, this
adds its licence and its copyright holders. Where a package offers several licences, it is distributed under the first of
PREFERRED that it offers. A package whose licence is not known here ends the script: add the licence then.
"""

import json
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAMS = ["facewire", "facewire-tools", "facewire-console"]
# Licences by their names in Cargo.toml, with Debian's names for them.
PREFERRED = {"MIT": "Expat", "Apache-2.0": "Apache-2.0", "MPL-2.0": "MPL-2.0", "ISC": "ISC",
             "BSD-3-Clause": "BSD-3-clause-of-holders"}
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


def linked_packages(target, options):
    """Returns the packages whose code is in a program, sorted by name: those that the programs depend on when they run."""
    linked = set()
    for program in PROGRAMS:
        tree = cargo("tree", f"--package={program}", "--edges=normal,no-proc-macro", f"--target={target}", "--prefix=none",
                     "--format={p}", *options)
        # A line is a name, a version, and remarks in brackets.
        linked |= {tuple(line.split(" ")[:2]) for line in tree.splitlines() if line}
    found = json.loads(cargo("metadata", "--format-version=1", f"--filter-platform={target}"))["packages"]
    packages = [one for one in found if one["source"] and (one["name"], "v" + one["version"]) in linked]
    return sorted(packages, key=lambda package: (package["name"], package["version"]))


def licence_of(package):
    """Returns Debian's name of the licence under which the package is distributed."""
    # What is based on the Independent JPEG Group's software says so besides; the text of its licence stands there.
    licence, of_jpeg = re.subn(r"^\((.*)\) AND IJG$", r"\1", (package["license"] or "").strip())
    offered = re.split(r"\s+OR\s+|/", licence)
    for name, debian in PREFERRED.items():
        if name in offered:
            return f"{debian} and IJG" if of_jpeg else debian
    return fail(f"{package['name']} has the licence {package['license']!r}: add it to PREFERRED, with its text")


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
    (jpeg,) = files_of(by_name["turbojpeg-sys"], "libjpeg-turbo/LICENSE.md")
    (ijg,) = files_of(by_name["turbojpeg-sys"], "libjpeg-turbo/README.ijg")
    bsd = section(jpeg.read_text("utf-8"), "Redistribution and use", "Why Two Licenses")
    found = {
        "Expat": section((ROOT / "LICENSE-MIT").read_text("utf-8"), "Permission is", None),
        "BSD-3-clause": bsd,
        "IJG": section(ijg.read_text("utf-8").split("LEGAL ISSUES\n============")[1], "In plain English", "REFERENCES"),
    }
    for name in ("Apache-2.0", "MPL-2.0", "GPL-3"):
        found[name] = COMMON.format(name)
    for name, first in (("ISC", "Permission to use"), ("BSD-3-clause-of-holders", "Redistribution and use")):
        files = [files_of(package, "LICENSE*")[0] for package in packages if licence_of(package) == name]
        found_texts = {section(file.read_text("utf-8"), first, None) for file in files}
        if len(found_texts) > 1:
            fail(f"the texts of {name} differ: give each a name of its own")
        found.update((name, text) for text in found_texts)
    return found


def main():
    """Writes the file."""
    if len(sys.argv) < 2:
        fail("usage: copyright.py TARGET [CARGO-OPTION]...")
    packages = linked_packages(sys.argv[1], sys.argv[2:])
    parts = [(ROOT / "packaging" / "copyright").read_text("utf-8")]
    for package in packages:
        fields = [
            ("Files", [f"rust/{package['name']}-{package['version']}/*"]),
            ("Copyright", holders_of(package)),
            ("License", [licence_of(package)]),
        ]
        if package["repository"]:
            fields.append(("Comment", [f"Linked into a program. Source: {package['repository']}"]))
        parts.append(paragraph(*fields))
    used = set(re.findall(r"^License: (.*)$", "\n".join(parts), re.MULTILINE))
    used = {name for names in used for name in re.split(r" or | and ", names)}
    known = texts(packages)
    parts += [licence_paragraph(name, known[name]) for name in sorted(used)]
    print("\n".join(parts), end="")


if __name__ == "__main__":
    main()
