#!/usr/bin/env python3
"""Ranks mixtures of expressions for `facewire-fit synth --mix` without rendering a picture.

A quadratic map from coefficients to landmarks is fitted to DATASET (an archive of `synth`, or one like it). A face is
then this map of its expression plus what the map did not explain in one of the pictures: errors of the tracker, traces of
the pose. A small network is trained on such faces with the expressions of a mixture, and judged on faces with the
expressions of the judging set, on the expressions of DATASET, and on turned heads at rest, all with what remains of
people whom the network has not seen. The figures rank mixtures; they do not predict those of a rendered set.

    pip install numpy
    fit/mixes.py ../shared/dataset/train.npz recorded=92,rest=8 halves=92,rest=8

Each mixture takes about ten seconds. Set FACEWIRE_FIT to the program if it is not in the path.
"""

import argparse
import csv
import json
import os
import pathlib
import subprocess
import tempfile

import numpy as np

FACES = 8_000
JUDGED = 3_000
TURNED_DEG = 18
HIDDEN, COMPONENTS, EPOCHS, BATCH = 100, 150, 12, 128
# Landmarks of forehead, nose and outer face, which expressions move least.
RIGID = [10, 151, 9, 8, 168, 6, 197, 195, 5, 4, 1, 19, 94, 234, 454, 127, 356, 33, 263, 133, 362, 93, 323, 162, 389, 21,
         251, 54, 284, 103, 332, 67, 297, 109, 338]


def aligned(faces, target):
    """Aligns each face with `target` by a rotation, a scale and a shift (Kabsch)."""
    own, other = faces[:, RIGID], target[:, RIGID]
    own_centre, other_centre = own.mean(1, keepdims=True), other.mean(1, keepdims=True)
    own, other = own - own_centre, other - other_centre
    u, size, vt = np.linalg.svd(np.einsum("nki,nkj->nij", own, other))
    sign = np.ones((len(faces), 3))
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotation = np.einsum("nij,nj,njk->nik", u, sign, vt)
    scale = (size * sign).sum(1) / (own**2).sum((1, 2))
    return (faces - own_centre) @ rotation * scale[:, None, None] + other_centre


class StandIn:
    """Makes landmarks of expressions, relative to the neutral face."""

    def __init__(self, path):
        data, names = np.load(path), json.loads(path.with_name("names.json").read_text())
        self.names = names
        self.weights = data["weights"].astype(float)
        self.at = {name: index for index, name in enumerate(names)}
        neutral, subject = data["meta"][:, -1] > 0, data["subject"]
        first = dict(zip(subject[neutral], np.flatnonzero(neutral)))
        faces = data["landmarks"].astype(float)
        mean = aligned(faces[neutral], np.repeat(faces[neutral][:1], neutral.sum(), 0)).mean(0, keepdims=True)
        mean = (mean - mean.mean(1, keepdims=True)) / np.linalg.norm(mean[0, 33] - mean[0, 263])
        faces = aligned(faces, np.repeat(mean, len(faces), 0))
        own = faces[[first[person] for person in subject]]
        moved = (faces - own).reshape(len(faces), -1)
        self.person = (own - mean).reshape(len(faces), -1).astype(np.float32)
        self.shown = np.flatnonzero(~neutral)
        terms = self.terms(self.weights[self.shown])
        gram = terms.T @ terms + 3 * np.eye(terms.shape[1])
        self.map = np.linalg.solve(gram, terms.T @ moved[self.shown]).astype(np.float32)
        self.rest = (moved - self.terms(self.weights) @ self.map).astype(np.float32)
        held_out = subject[self.shown] % 5 == 0
        self.seen, self.unseen = self.shown[~held_out], self.shown[held_out]
        self.turned = self.unseen[np.abs(data["pose"][self.unseen, 0]) > TURNED_DEG]

    def terms(self, weights):
        """Returns the coefficients, their squares, and products of those that act on the same points."""
        starts = {"jawOpen": "mouth", "eyeBlinkLeft": "eye", "eyeBlinkRight": "eye"}
        products = [
            weights[:, [self.at[name]]] * weights[:, [i for i, other in enumerate(self.names) if other.startswith(start)]]
            for name, start in starts.items()
        ]
        return np.concatenate([weights, weights**2, *products], 1)

    def faces(self, weights, pictures, rng):
        """Returns the features of faces with the neutral face known, and not known."""
        drawn = rng.choice(pictures, len(weights))
        known = (self.terms(weights) @ self.map).astype(np.float32) + self.rest[drawn]
        return known, known + self.person[drawn]

    def expressions(self, arguments, count):
        """Draws expressions by `facewire-fit expressions`."""
        program = os.environ.get("FACEWIRE_FIT", "facewire-fit")
        with tempfile.TemporaryDirectory() as folder:
            page, table = f"{folder}/page.html", f"{folder}/table.csv"
            command = [program, "expressions", page, "--csv", table, "--count", str(count), *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            rows = list(csv.DictReader(open(table)))
        return np.array([[float(row[name]) for name in self.names] for row in rows])


class Network:
    """One hidden layer on principal components."""

    def __init__(self, inputs, truth):
        rng = np.random.default_rng(0)
        self.mean, self.scale = inputs.mean(0), inputs.std(0) + 0.004
        some = ((inputs - self.mean) / self.scale)[rng.choice(len(inputs), 3000, replace=False)]
        _, size, axes = np.linalg.svd(some - some.mean(0), full_matrices=False)
        size = np.maximum(size[:COMPONENTS] / len(some) ** 0.5, 0.02 * size[0] / len(some) ** 0.5)
        self.basis = (axes[:COMPONENTS].T / size**0.6).astype(np.float32)
        self.deviation = truth.std(0) + 0.02
        self.train(self.components(inputs), (truth / self.deviation).astype(np.float32), rng)

    def components(self, inputs):
        return ((inputs - self.mean) / self.scale @ self.basis).astype(np.float32)

    def train(self, inputs, truth, rng):
        """AdamW with a falling rate. Faces at rest count three times, as in `facewire-fit train`."""
        importance = np.where(truth.max(1) == 0, 3, 1).astype(np.float32)
        width, outputs = inputs.shape[1], truth.shape[1]
        self.parts = [part.astype(np.float32) for part in (
            rng.normal(0, (2 / width) ** 0.5, (width, HIDDEN)), np.zeros(HIDDEN),
            rng.normal(0, 0.1 / HIDDEN**0.5, (HIDDEN, outputs)), truth.mean(0))]
        moments = [[np.zeros_like(part) for part in self.parts] for _ in range(2)]
        steps = EPOCHS * (len(inputs) // BATCH)
        for step in range(steps):
            rows = rng.choice(len(inputs), BATCH)
            noisy = inputs[rows] + 0.1 * rng.standard_normal((BATCH, width), dtype=np.float32)
            hidden = np.maximum(noisy @ self.parts[0] + self.parts[1], 0)
            error = (hidden @ self.parts[2] + self.parts[3] - truth[rows]) * importance[rows, None] / BATCH
            back = (error @ self.parts[2].T) * (hidden > 0)
            rate = 1e-3 * (1 + np.cos(np.pi * step / steps))
            for part, gradient, first, second in zip(
                    self.parts, [noisy.T @ back, back.sum(0), hidden.T @ error, error.sum(0)], *moments):
                first += 0.1 * (gradient - first)
                second += 0.001 * (gradient**2 - second)
                steepness = np.sqrt(second / (1 - 0.999 ** (step + 1))) + 1e-8
                part -= rate * (first / (1 - 0.9 ** (step + 1)) / steepness + 1e-4 * part)

    def __call__(self, inputs):
        hidden = np.maximum(self.components(inputs) @ self.parts[0] + self.parts[1], 0)
        return np.clip((hidden @ self.parts[2] + self.parts[3]) * self.deviation, 0, 1)


def score(estimate, truth):
    """Returns the mean r over the blendshapes that move, and the mean squared error."""
    moving = np.flatnonzero(truth.std(0) > 0.02)
    r = [np.corrcoef(estimate[:, index], truth[:, index])[0, 1] for index in moving]
    return f"{np.mean(r):.3f} | {((estimate - truth) ** 2).mean():.4f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("mixtures", nargs="+", metavar="KIND=SHARE,...")
    arguments = parser.parse_args()
    stand_in = StandIn(arguments.dataset)
    modelled = [index for index, name in enumerate(stand_in.names) if name != "tongueOut"]
    judged = stand_in.expressions(["--set", "judge"], JUDGED)
    print("| mixture | judging set, known: r | MSE | not known: r | MSE | dataset, known: r | MSE | turned rest: mean | highest |")
    print("|---|---|---|---|---|---|---|---|---|")
    for mixture in arguments.mixtures:
        rng = np.random.default_rng(1)
        drawn = stand_in.expressions(["--mix", mixture], FACES)
        inputs = np.concatenate(stand_in.faces(drawn, stand_in.seen, rng))
        network = Network(inputs, np.concatenate([drawn, drawn])[:, modelled])
        cells = [score(network(faces), judged[:, modelled]) for faces in stand_in.faces(judged, stand_in.unseen, rng)]
        own = stand_in.weights[stand_in.shown[:JUDGED]]
        cells.append(score(network(stand_in.faces(own, stand_in.unseen, rng)[0]), own[:, modelled]))
        still = np.zeros((len(stand_in.turned), len(stand_in.names)))
        rest = network(stand_in.faces(still, stand_in.turned, rng)[0]).mean(0)
        print(f"| `{mixture}` | {' | '.join(cells)} | {rest.mean():.3f} | {rest.max():.3f} |", flush=True)


if __name__ == "__main__":
    main()
