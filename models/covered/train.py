#!/usr/bin/env python3
"""Trains the networks for faces of which a part is covered.

    pip install numpy torch
    models/covered/train.py faces/covered/faces.npz

The archives are those of `facewire-fit synth`. `models/visible.fwnet` reads the feature map of the mesh network at its
landmarks and gives, for each region, the log-odds that it is in view. `models/mouth.fwnet` reads a grey picture of the mouth
and gives its coefficients. It does not know the wearer, but neither does it need the eyes, which a headset covers.
In training, a layer that is not written reads its values together with landmarks.

Training changes place, size, turn, sharpness, light and noise of each picture, which is then made even in brightness and
contrast. The mirror image of a face counts as another face. A covered mouth does not count. All subjects but one in eight are
trained on, and the result is judged on those. `--judge` judges the regions in further archives.
"""

import argparse
import importlib.util
import json
import pathlib

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

ROOT = pathlib.Path(__file__).resolve().parents[2]
_spec = importlib.util.spec_from_file_location("eyes", ROOT / "models/eyes/train.py")
eyes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(eyes)

# As in face/src/track/mouth.rs and fit/src/dataset.rs: the side of a picture, and where in `features` it begins.
SIDE, MAP = 64, 5760
FIRST = MAP + 2 * 32 * 32
REGIONS = ["left_eye", "right_eye", "brows", "mouth", "cheeks"]
HELD_OUT, IN_VIEW = 8, 0.6
STEM, BLOCKS = 16, ((2, 24), (1, 24), (2, 48), (1, 48), (2, 64), (1, 64))
FEWER = 32
# In training, further values of the picture and these landmarks, in a frame of the mouth's own, give the coefficients as well.
VALUES, UNITS_SHAPE, NOISE = 32, 64, 0.05
MIDDLE, LEVEL, SIZE = [61, 291, 0, 17], [[61, 291], [58, 288], [172, 397]], [[58, 288], [172, 397]]
POINTS = [61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409, 78, 95, 88, 178, 87, 14,
          317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415, 2, 98, 327, 164, 1, 129, 358, 205, 425, 50, 280,
          187, 411, 207, 427, 216, 436, 212, 432, 202, 422, 43, 273, 57, 287, 106, 335, 182, 406, 18, 200, 199, 175, 152, 148,
          377, 176, 400, 150, 379, 136, 365, 172, 397, 58, 288]
BATCH, RATE, DECAY = 256, 4e-3, 2e-3
# Errors at amplitudes that are rare weigh more: the share of the pictures in a band of amplitude, to this power.
BANDS, RARITY = np.array([0.02, 0.15, 0.3, 0.5, 0.7]), -0.4
PREFIXES = ("jaw", "mouth", "cheekPuff")
# The network of the regions, and how it is trained.
UNITS, EPOCHS_VISIBLE, RATE_VISIBLE, DECAY_VISIBLE = 8, 8, 1e-3, 2e-2


def framed(landmarks):
    """Returns the landmarks of the mouth in its own frame, of all those of some faces (faces, landmarks, 3)."""
    level, size = np.array(LEVEL), np.array(SIZE)
    centre = landmarks[:, MIDDLE].mean(1, keepdims=True)
    along = (landmarks[:, level[:, 1]] - landmarks[:, level[:, 0]])[..., :2].sum(1)
    angle = np.arctan2(along[:, 1], along[:, 0])
    lines = (landmarks[:, size[:, 1]] - landmarks[:, size[:, 0]])[..., :2]
    unit = np.hypot(lines[..., 0], lines[..., 1]).sum(1)
    x, y, z = np.moveaxis((landmarks[:, POINTS] - centre) / unit[:, None, None], 2, 0)
    sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], 2).astype(np.float32)


class Mouths:
    """The pictures of mouths in view in some archives, their landmarks, true coefficients, and subjects."""

    def __init__(self, paths):
        pictures, points, truth, held_out = [], [], [], []
        for path in paths:
            archive = np.load(path)
            names = json.loads(path.with_name("names.json").read_text())
            self.names = [name for name in names if name.startswith(PREFIXES)]
            shown = archive["visible"][:, REGIONS.index("mouth")] > IN_VIEW
            pictures.append(archive["features"][shown, FIRST:FIRST + SIDE * SIDE].astype(np.uint8))
            points.append(framed(archive["landmarks"][shown]))
            truth.append(archive["weights"][shown][:, [names.index(name) for name in self.names]])
            held_out.append(archive["subject"][shown] % HELD_OUT == HELD_OUT - 1)
        self.pictures = torch.from_numpy(np.concatenate(pictures).reshape(-1, 1, SIDE, SIDE))
        self.truth = torch.from_numpy(np.concatenate(truth))
        held_out = np.concatenate(held_out)
        self.judged, self.seen = np.flatnonzero(held_out), np.flatnonzero(~held_out)
        other = lambda name: name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")
        self.mirrored = [self.names.index(other(name)) for name in self.names]
        points = np.concatenate(points)
        # The landmark that is nearest to the mirror image of another one in the mean of all faces.
        mean = points.mean(0)
        self.opposite = np.linalg.norm(mean[:, None] * np.float32([-1, 1, 1]) - mean, axis=2).argmin(1)
        self.points = torch.from_numpy(points)
        bands = np.digitize(self.truth.numpy(), BANDS)
        shares = np.stack([(bands[self.seen] == band).mean(0) for band in range(len(BANDS) + 1)])
        weights = np.where(shares > 0, np.maximum(shares, 1e-3) ** RARITY, 0)
        self.weights = torch.from_numpy(np.take_along_axis(weights, bands, 0).astype(np.float32))
        self.weights /= self.weights.mean(0)


def varied(pictures, random):
    """Changes place, size, turn, sharpness, light and noise."""
    count = len(pictures)
    uniform = lambda low, high: torch.empty(count).uniform_(low, high)
    size, turn = torch.exp(uniform(-0.13, 0.13)), uniform(-0.13, 0.13)
    x, y = uniform(-0.13, 0.13), uniform(-0.13, 0.13)
    matrix = torch.stack([size * turn.cos(), -size * turn.sin(), x, size * turn.sin(), size * turn.cos(), y], 1)
    grid = F.affine_grid(matrix.reshape(-1, 2, 3), [count, 1, SIDE, SIDE], align_corners=False)
    pictures = F.grid_sample(pictures.float(), grid, padding_mode="border", align_corners=False)
    if random.random() < 0.3:
        pictures = F.avg_pool2d(pictures, 3, 1, 1, count_include_pad=False)
    if random.random() < 0.15:
        pictures = F.avg_pool2d(pictures, 5, 1, 2, count_include_pad=False)
    slope, place = torch.empty(2, count, 1, 1, 1).uniform_(-0.4, 0.4), torch.linspace(-1, 1, SIDE)
    pictures = pictures * (1 + slope[0] * place + slope[1] * place[:, None])
    pictures = eyes.evened(pictures)
    return pictures + torch.rand(count, 1, 1, 1) * 0.2 * torch.randn_like(pictures)


class Mouth(nn.Module):
    """The network: from the picture of a mouth to its coefficients. In training, a further layer estimates the coefficients from
    values of the picture and the landmarks together, which improves what the network sees.
    """

    def __init__(self, faces):
        super().__init__()
        self.stem = nn.Conv2d(1, STEM, 5, 2, bias=False)
        self.scale, self.activation = nn.BatchNorm2d(STEM), nn.PReLU(STEM)
        before = [STEM, *(channels for _, channels in BLOCKS)]
        self.blocks = nn.Sequential(*(eyes.Block(stride, c, channels) for c, (stride, channels) in zip(before, BLOCKS)))
        self.fewer = nn.Conv2d(before[-1], FEWER, 1, bias=False)
        self.fewer_scale, self.fewer_activation = nn.BatchNorm2d(FEWER), nn.PReLU(FEWER)
        self.count, points = len(faces.names), faces.points[faces.seen].flatten(1)
        self.outputs = nn.Conv2d(FEWER, self.count + VALUES, SIDE // 16)
        self.mean, self.deviation = points.mean(0), points.std(0) + 2e-3
        self.sums, self.both_activation = nn.Linear(VALUES + points.shape[1], UNITS_SHAPE), nn.PReLU(UNITS_SHAPE)
        self.both = nn.Linear(UNITS_SHAPE, self.count)

    def forward(self, x, points):
        x = self.activation(self.scale(self.stem(F.pad(x, (1, 2, 1, 2)))))
        x = self.fewer_activation(self.fewer_scale(self.fewer(self.blocks(x))))
        found = self.outputs(F.dropout(x, 0.1, self.training)).flatten(1)
        points = (points.flatten(1) - self.mean) / self.deviation
        points = points + NOISE * torch.randn_like(points)
        sums = self.both_activation(self.sums(torch.cat([found[:, self.count:], points], 1)))
        return found[:, :self.count], self.both(F.dropout(sums, 0.1, self.training))


def train(faces, epochs):
    """Returns the trained network."""
    random = np.random.default_rng(1)
    torch.manual_seed(1)
    mouth = Mouth(faces).to(memory_format=torch.channels_last)
    print(f"{len(faces.seen)} pictures")

    def loss_of(rows):
        pictures, points, truth, weights = (each[rows] for each in (faces.pictures, faces.points, faces.truth, faces.weights))
        if random.random() < 0.5:
            pictures, truth, weights = pictures.flip(3), truth[:, faces.mirrored], weights[:, faces.mirrored]
            points = points[:, faces.opposite] * torch.tensor([-1, 1, 1])
        pictures = varied(pictures, random).contiguous(memory_format=torch.channels_last)
        return sum((weights * (found - truth) ** 2).mean() for found in mouth(pictures, points))

    return eyes.optimised(mouth, faces.seen, epochs, BATCH, RATE, DECAY, loss_of)


def judge(mouth, faces):
    """Prints how well the held-out subjects are estimated, who are not part of the training."""
    with torch.no_grad():
        found = torch.cat([mouth(eyes.evened(faces.pictures[rows].float()), faces.points[rows])[0]
                           for rows in np.array_split(faces.judged, len(faces.judged) // BATCH + 1)]).numpy()
    truth = faces.truth[faces.judged].numpy()
    rows = [(np.corrcoef(x, y)[0, 1], np.polyfit(x, y, 1)[0], ((x - y) ** 2).mean()) for x, y in zip(truth.T, found.T)]
    for name, (r, slope, error) in zip(faces.names, rows):
        print(f"{name:20} r {r:.3f} slope {slope:.2f} MSE {error:.4f}")
    print("mean of {}: r {:.3f}, slope {:.2f}, MSE {:.4f}".format(len(rows), *np.mean(rows, 0)))


def network(mouth):
    """Returns the content of the network's file."""
    writer, side, before = eyes.Writer(), SIDE // 2, STEM
    source = writer.tensor(SIDE, 1)
    x = writer.add(eyes.CONVOLUTION, [source], (side, STEM), 5, 2, 1, eyes.folded(mouth.stem, mouth.scale))
    x = writer.add(eyes.PRELU, [x], (side, STEM), arrays=[mouth.activation.weight])
    x, side, _ = eyes.write_blocks(writer, x, side, before, mouth.blocks, BLOCKS)
    x = writer.add(eyes.CONVOLUTION, [x], (side, FEWER), arrays=eyes.folded(mouth.fewer, mouth.fewer_scale))
    x = writer.add(eyes.PRELU, [x], (side, FEWER), arrays=[mouth.fewer_activation.weight])
    last = [mouth.outputs.weight[:mouth.count].permute(0, 2, 3, 1), mouth.outputs.bias[:mouth.count]]
    return writer.content(source, writer.add(eyes.CONVOLUTION, [x], (1, mouth.count), side, arrays=last))


def train_visible(paths, epochs):
    """Returns a network from the feature map to the log-odds that each region is in view, and prints how good it is."""
    torch.manual_seed(1)
    values, shown, held_out = [], [], []
    for path in paths:
        archive = np.load(path)
        values.append(archive["features"][:, :MAP])
        shown.append(archive["visible"])
        held_out.append(archive["subject"] % HELD_OUT == HELD_OUT - 1)
    values, shown, held_out = map(np.concatenate, (values, shown, held_out))
    sample = values[::8].astype(np.float32)
    mean, deviation = map(torch.from_numpy, (sample.mean(0), sample.std(0) + 0.02 * sample.std()))
    values, shown = map(torch.from_numpy, (values, shown))
    seen, judged = np.flatnonzero(~held_out), np.flatnonzero(held_out)
    net = nn.Sequential(nn.Linear(MAP, UNITS), nn.PReLU(UNITS), nn.Linear(UNITS, len(REGIONS)))
    even = lambda values: (values.float() - mean) / deviation

    def loss_of(rows):
        varied_values = even(values[rows]) + 0.4 * torch.randn(len(rows), MAP)
        return F.binary_cross_entropy_with_logits(net(F.dropout(varied_values, 0.3)), shown[rows])

    eyes.optimised(net, seen, epochs, BATCH, RATE_VISIBLE, DECAY_VISIBLE, loss_of)

    def odds_of(values):
        with torch.no_grad():
            return torch.cat([net(even(part)) for part in values.split(BATCH)]).numpy()

    report_visible(odds_of(values[judged]), shown[judged].numpy())
    first, activation, last = net
    weights = first.weight / deviation
    first_bias = first.bias - weights @ mean
    writer = eyes.Writer()
    source = writer.tensor(1, MAP)
    x = writer.add(eyes.CONVOLUTION, [source], (1, UNITS), arrays=[weights, first_bias])
    x = writer.add(eyes.PRELU, [x], (1, UNITS), arrays=[activation.weight])
    x = writer.add(eyes.CONVOLUTION, [x], (1, len(REGIONS)), arrays=[last.weight, last.bias])
    return writer.content(source, x), odds_of


def report_visible(odds, shown):
    """Prints for each region the area under the ROC curve, and which share of regions in view count as covered."""
    for name, x, y in zip(REGIONS, odds.T, shown.T):
        clear, covered = x[y > 0.85], x[y < 0.35]
        ranks = np.argsort(np.argsort(np.concatenate([clear, covered])))[:len(clear)]
        area = (ranks.sum() - len(clear) * (len(clear) - 1) / 2) / max(len(clear) * len(covered), 1)
        false = (x[y > 0.95] < 0).mean()
        print(f"{name:10} area {area:.4f}, in view and called covered {100 * false:.2f} %, {len(covered)} covered")


def main():
    """Trains, judges, and writes the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archives", nargs="+", type=pathlib.Path, metavar="FACES.npz")
    parser.add_argument("--judge", nargs="+", type=pathlib.Path, metavar="FACES.npz", default=[],
                        help="archives in which the regions in view are judged, too")
    parser.add_argument("--epochs", type=int, default=12, help="passes over the pictures of mouths (default: 12)")
    parser.add_argument("--only", choices=["mouth", "visible"], help="train this network alone")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "models", help="folder of the networks")
    arguments = parser.parse_args()
    if arguments.only != "mouth":
        content, odds_of = train_visible(arguments.archives, EPOCHS_VISIBLE)
        (arguments.out / "visible.fwnet").write_bytes(content)
        for path in arguments.judge:
            archive = np.load(path)
            print(path)
            report_visible(odds_of(torch.from_numpy(archive["features"][:, :MAP])), archive["visible"])
    if arguments.only != "visible":
        faces = Mouths(arguments.archives)
        mouth = train(faces, arguments.epochs)
        judge(mouth, faces)
        (arguments.out / "mouth.fwnet").write_bytes(network(mouth))


if __name__ == "__main__":
    main()
