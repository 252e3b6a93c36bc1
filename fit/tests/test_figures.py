"""What fit/figures.py promises: it writes what was judged, and nothing else."""

import json
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

FIT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(FIT))

import figures  # noqa: E402 (it stands beside this folder)


def judged(r):
    """What `judge --json` writes of a model whose estimates correlate so, with a weak left sneer and a jaw that never moves."""
    def row(name):
        slope = {"noseSneerLeft": 0.2, "noseSneerRight": 0.4, "mouthLeft": 0.3}.get(name, 0.9)
        found = {"r": r, "mse": 0.01, "slope": slope, "jitter": 0.02}
        if name == "jawLeft":
            found.update(r=None, slope=None)
        interval = {"low": r - 0.05, "high": r + 0.05}
        return {"all": {figure: {"value": value, "interval": interval} for figure, value in found.items()}}

    rows = {name: row(name) for name in [*figures.NAMES, "mean_of_blendshapes", "mean_of_people"]}
    states = {f"neutral_face_{state}": {"model": {"figures": rows}} for state in figures.STATES}
    return {"sets": [{"neutral": states}]}


class Figures(unittest.TestCase):
    def test_tables_are_those_that_were_judged_and_everything_else_stays(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            for number, (name, _, _) in enumerate(figures.commands()):
                (folder / f"{name}.json").write_text(json.dumps(judged(0.9 - number / 100)))
            for name in ("README.md", "FIGURES.md"):
                shutil.copy(FIT / name, folder)
            command = [sys.executable, FIT / "figures.py", folder, "--keep", "--into", folder]
            subprocess.run(command, check=True)
            readme, shapes = ((folder / name).read_text() for name in ("README.md", "FIGURES.md"))
        row = "0.890 (0.840 .. 0.940) | 0.0100 | 0.90"
        self.assertIn(f"| judging set | {row} | {row} |", readme)
        self.assertIn("known: mouthLeft (0.30), noseSneer (0.30). Jitter at rest is 0.0200 known, 0.0200 not known.", readme)
        self.assertIn("| r | 0.870 | 0.860 | 0.850 | 0.840 | 0.830 | 0.820 |", readme)
        self.assertIn("| jawOpen | 0.890 ± 0.050 | 0.0100 | 0.890 ± 0.050 | 0.0100 | 0.880 ± 0.050 | 0.0100 |", shapes)
        self.assertIn("| jawLeft | - | 0.0100 |", shapes)
        self.assertEqual(len(shapes.splitlines()), len((FIT / "FIGURES.md").read_text().splitlines()))
        for written, name in [(readme, "README.md"), (shapes, "FIGURES.md")]:
            lines = (FIT / name).read_text().splitlines()
            outside = [line for line in lines if not line.startswith("|")]
            self.assertGreater(len(set(outside) & set(written.splitlines())), 0.9 * len(set(outside)))


if __name__ == "__main__":
    unittest.main()
