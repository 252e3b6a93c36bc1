"""library/public-api notices what breaks users of a release."""

import importlib.machinery
import importlib.util
import pathlib
import sys
import unittest

PATH = pathlib.Path(__file__).resolve().parents[2] / "library" / "public-api"


def load():
    """Returns the script as a module, and leaves no compiled file beside it."""
    sys.dont_write_bytecode = True
    loader = importlib.machinery.SourceFileLoader("public_api", str(PATH))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("public_api", loader))
    loader.exec_module(module)
    return module


class Rule(unittest.TestCase):
    """A line of the last release may go with a version that is incompatible with it."""

    def test_what_is_gone_needs_an_incompatible_version_and_what_is_new_does_not(self):
        broken = load().broken
        released = "fn a() -> ()\nfn b() -> ()\n"
        added, changed = released + "fn c() -> ()\n", "fn a() -> u8\nfn b() -> ()\n"
        for old, new, found in (
            ("0.1.0", "0.1.0", ["fn a() -> ()"]), ("0.1.0", "0.1.7", ["fn a() -> ()"]), ("0.1.0", "0.2.0", []),
            ("1.2.3", "1.9.0", ["fn a() -> ()"]), ("1.2.3", "2.0.0", []), ("0.0.3", "0.0.4", []), ("0.1.0", "1.0.0", []),
        ):
            self.assertEqual(broken(released, changed, old, new), found, (old, new))
            self.assertEqual(broken(released, added, old, new), [], (old, new))

    def test_the_last_release_is_the_newest_tag_of_a_version(self):
        script = load()
        answers = {"tag": "v0.2.0-rc1\nv0.1.0\nv0.0.1\nother\n", "show v0.1.0:library/public-api.txt": "fn a() -> ()\n"}
        script.git = lambda *arguments: answers[arguments[0] if arguments[0] == "tag" else " ".join(arguments)]
        script.check_release("fn a() -> ()\n", "0.1.1")
        script.check_release("", "0.2.0")
        with self.assertRaisesRegex(SystemExit, "(?s)fn a.*v0.1.0 are gone: 0.1.1"):
            script.check_release("", "0.1.1")


if __name__ == "__main__":
    unittest.main()
