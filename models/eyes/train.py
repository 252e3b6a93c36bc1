#!/usr/bin/env python3
"""Trains the network of the eyes, and the layer that turns its values into the direction of the gaze.

    pip install numpy torch
    models/eyes/train.py faces/{gaze,sharp,halves}/faces.npz

The archives are those of `facewire-fit synth`. The network (`models/eyes.fwnet`) reads the grey picture of one eye; the left
one is mirrored. The layer, the table `[eyes]` of `models/blendshapes.toml`, reads the network's values for both eyes, some
points of the eyes in the head's own basis, and how the head is turned. Both are trained together on all subjects but one in
eight, by which the result is judged.

What carries over from rendered eyes to real ones was chosen on films of real people: each picture is made even in brightness
and contrast, and training changes its place, size, sharpness, light and noise. The mirror image of a face counts as another
face. Faces whose lids are shut do not count.
"""

import argparse
import json
import pathlib
import re
import struct
import time
import zlib

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

ROOT = pathlib.Path(__file__).resolve().parents[2]
# As in face/src/track/eyes.rs and face/src/model/mod.rs.
SIDE, VALUES, UNITS, LEAST_CONTRAST = 32, 32, 64, 4.0
# Values of the feature map, which come before the pictures of the eyes.
MAP = 5760
FULL_GAZE_DEG, SHUT, HELD_OUT = 35, 0.6, 8
# Lids, iris and corners of the right eye, then their mirror images.
RIGHT, LEFT = (159, 145, 468, 33, 133), (386, 374, 473, 263, 362)
POINTS = RIGHT + LEFT
INPUTS = [f"{axis}{point}" for point in POINTS for axis in "xy"] + ["yaw", "pitch", "roll"]
# The input that takes the place of each in a mirrored face, and its sign.
MIRRORED = torch.tensor([*range(10, 20), *range(10), 20, 21, 22])
SIGNS = torch.tensor([-1.0, 1.0] * 10 + [-1.0, 1.0, -1.0])
# The stride of each block of the network, and its channels.
CHANNELS, BLOCKS = 16, ((1, 16), (2, 32), (1, 32), (2, 64), (1, 64))
BATCH, RATE, DECAY, BEND_DEG = 512, 4e-3, 2e-3, 3.0
# Training for the least error makes movements too small. These factors on yaw and pitch, chosen on films, give them their true
# size. `judge` prints the figures without them.
GAINS = np.array([1.15, 1.19])
# Kinds of operator in a network's file (engine/src/file.rs).
CONVOLUTION, DEPTHWISE, PRELU, ADD, MAX_POOL, PAD_CHANNELS = 0, 1, 2, 4, 5, 6


def head_basis(landmarks):
    """Returns landmarks in the head's own basis, and its rotations (n x 3 x 3), as face/src/solve/affine.rs computes them."""
    source = (ROOT / "face/src/solve/affine.rs").read_text()
    rigid = re.findall(r"\((\d+), \[(.+?), (.+?), (.+?)\]\),", source)
    canonical = np.array([list(map(float, row[1:])) for row in rigid])
    points = landmarks * np.array([1.0, -1.0, -1.0])
    seen = points[:, [int(row[0]) for row in rigid]]
    centred, wanted = seen - seen.mean(1, keepdims=True), canonical - canonical.mean(0)
    left, sizes, right = np.linalg.svd(np.einsum("nki,kj->nij", centred, wanted))
    sizes[:, 2] *= (handedness := np.sign(np.linalg.det(left) * np.linalg.det(right)))
    left[:, :, 2] *= handedness[:, None]
    rotation, scale = left @ right, sizes.sum(1) / (wanted**2).sum()
    origin = seen.mean(1) - scale[:, None] * (rotation @ canonical.mean(0))
    return (points - origin[:, None]) @ rotation / scale[:, None, None], rotation


class Faces:
    """The open eyes of some archives: pictures, inputs, true directions in degrees, and subjects."""

    def __init__(self, paths):
        parts = [self._load(path) for path in paths]
        self.pictures, self.inputs, self.truth, held_out = (np.concatenate(part) for part in zip(*parts))
        self.pictures, self.inputs, self.truth = map(torch.from_numpy, (self.pictures, self.inputs, self.truth))
        self.judged, self.seen = (np.flatnonzero(held_out == state) for state in (True, False))

    @staticmethod
    def _load(path):
        archive = np.load(path)
        names = json.loads(path.with_name("names.json").read_text())
        weights = archive["weights"]
        curve = lambda name: np.maximum(weights[:, names.index(name)], 0)
        sides = lambda name: np.stack([curve(name + side) for side in ("Left", "Right")])
        out, up = sides("eyeLookOut") - sides("eyeLookIn"), sides("eyeLookUp") - sides("eyeLookDown")
        truth = FULL_GAZE_DEG * np.stack([(out[0] - out[1]) / 2, up.mean(0)], 1)
        is_open = sides("eyeBlink").max(0) < SHUT
        pictures = archive["features"][is_open, MAP:MAP + 2 * SIDE * SIDE].astype(np.uint8).reshape(-1, 2, SIDE, SIDE)
        points, rotation = head_basis(archive["landmarks"][is_open])
        turns = np.stack([rotation[:, 0, 2], rotation[:, 1, 2], rotation[:, 1, 0]], 1)
        inputs = np.concatenate([points[:, POINTS, :2].reshape(len(points), -1), turns], 1)
        held_out = archive["subject"][is_open] % HELD_OUT == HELD_OUT - 1
        return pictures, inputs.astype(np.float32), truth[is_open].astype(np.float32), held_out


def evened(pictures):
    """Makes brightness and contrast of each picture the same."""
    deviation = pictures.std((2, 3), keepdim=True, unbiased=False) + LEAST_CONTRAST
    return (pictures - pictures.mean((2, 3), keepdim=True)) / deviation


def varied(pictures, random):
    """Changes place, size, sharpness, light and noise."""
    size, margin = random.integers(29, 37), 4
    x, y = margin + (SIDE - size) // 2 + random.integers(-2, 3, 2)
    pictures = F.pad(pictures.float(), [margin] * 4, mode="replicate")[:, :, y:y + size, x:x + size]
    pictures = F.interpolate(pictures, (SIDE, SIDE), mode="bilinear", align_corners=False)
    if random.random() < 0.25:
        pictures = F.avg_pool2d(pictures, 3, 1, 1, count_include_pad=False)
    if random.random() < 0.5:
        slope, place = torch.empty(2, len(pictures), 1, 1, 1).uniform_(-0.4, 0.4), torch.linspace(-1, 1, SIDE)
        pictures = pictures * (1 + slope[0] * place + slope[1] * place[:, None])
    pictures = evened(pictures)
    return pictures + torch.rand(len(pictures), 1, 1, 1) * 0.2 * torch.randn_like(pictures)


class Block(nn.Module):
    """A depthwise convolution, a pointwise one, and the sum with the input."""

    def __init__(self, stride, before, channels):
        super().__init__()
        self.stride, self.added = stride, channels - before
        self.depthwise = nn.Conv2d(before, before, 3, stride, groups=before, bias=False)
        self.pointwise = nn.Conv2d(before, channels, 1, bias=False)
        self.scale, self.activation = nn.BatchNorm2d(channels), nn.PReLU(channels)

    def forward(self, x):
        padded = F.pad(x, (0, 1, 0, 1) if self.stride == 2 else (1, 1, 1, 1))
        rest = F.pad(F.max_pool2d(x, self.stride), (0, 0, 0, 0, 0, self.added))
        return self.activation(self.scale(self.pointwise(self.depthwise(padded))) + rest)


class Eye(nn.Module):
    """The network: from the picture of an eye to its values."""

    def __init__(self):
        super().__init__()
        self.stem = nn.Conv2d(1, CHANNELS, 5, 2, bias=False)
        self.scale, self.activation = nn.BatchNorm2d(CHANNELS), nn.PReLU(CHANNELS)
        before = [CHANNELS, *(channels for _, channels in BLOCKS)]
        self.blocks = nn.Sequential(*(Block(stride, c, channels) for c, (stride, channels) in zip(before, BLOCKS)))
        self.values = nn.Conv2d(before[-1], VALUES, SIDE // 8)

    def forward(self, x):
        x = self.activation(self.scale(self.stem(F.pad(x, (1, 2, 1, 2)))))
        return self.values(self.blocks(x)).flatten(1)


def optimised(network, rows, epochs, batch, rate, decay, loss_of):
    """Minimises `loss_of`, a function of the numbers of some faces, and returns the network.

    Each epoch is a pass through `rows` in random order. The learning rate rises for a tenth of the steps, and then falls.
    """
    random, steps, started = np.random.default_rng(1), len(rows) // batch, time.time()
    optimiser = torch.optim.AdamW(network.parameters(), rate, weight_decay=decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=epochs * steps, pct_start=0.1)
    for epoch in range(epochs):
        order, total = random.permutation(rows), 0.0
        for step in range(steps):
            loss = loss_of(np.sort(order[step * batch:][:batch]))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item()
        print(f"epoch {epoch + 1} of {epochs}: loss {total / steps:.5f}, {time.time() - started:.0f} s", flush=True)
    return network.eval()


class Gaze(nn.Module):
    """The network and the layer: from the pictures of both eyes and the inputs to yaw and pitch in degrees."""

    def __init__(self, mean, deviation):
        super().__init__()
        self.eye, self.mean, self.deviation = Eye(), mean, deviation
        self.sums, self.outputs = nn.Linear(len(INPUTS) + 2 * VALUES, 2 + UNITS), nn.Linear(UNITS, 2, bias=False)

    def forward(self, pictures, inputs):
        eyes = self.eye(pictures.reshape(-1, 1, SIDE, SIDE).contiguous(memory_format=torch.channels_last))
        sums = self.sums(torch.cat([(inputs - self.mean) / self.deviation, eyes.reshape(len(inputs), -1)], 1))
        return 10 * (sums[:, :2] + self.outputs(sums[:, 2:].relu()))


def train(faces, epochs):
    """Returns the trained network and layer."""
    random = np.random.default_rng(1)
    torch.manual_seed(1)
    inputs = faces.inputs[faces.seen]
    both = torch.cat([inputs, inputs[:, MIRRORED] * SIGNS])
    gaze = Gaze(both.mean(0), both.std(0) + 1e-3).to(memory_format=torch.channels_last)
    print(f"{len(faces.seen)} faces with open eyes")

    def loss_of(rows):
        pictures, inputs, truth = varied(faces.pictures[rows], random), faces.inputs[rows], faces.truth[rows]
        if random.random() < 0.5:
            pictures, inputs, truth = pictures.flip(1), inputs[:, MIRRORED] * SIGNS, truth * torch.tensor([-1, 1])
        return F.smooth_l1_loss(gaze(pictures, inputs), truth, beta=BEND_DEG)

    return optimised(gaze, faces.seen, epochs, BATCH, RATE, DECAY, loss_of)


def judge(gaze, faces):
    """Prints how well the held-out subjects are estimated, who are not part of the training."""
    with torch.no_grad():
        parts = [gaze(evened(faces.pictures[rows].float()), faces.inputs[rows])
                 for rows in np.array_split(faces.judged, len(faces.judged) // BATCH + 1)]
    found, truth = torch.cat(parts).numpy(), faces.truth[faces.judged].numpy()
    for axis, name in enumerate(("yaw", "pitch")):
        x, y = truth[:, axis], found[:, axis]
        r, slope = np.corrcoef(x, y)[0, 1], np.polyfit(x, y, 1)[0]
        print(f"{name}: r {r:.3f}, slope {slope:.2f}, mean error {np.abs(x - y).mean():.1f} degrees, {len(x)} faces")


class Writer:
    """Collects tensors and operators in the form of engine/src/file.rs. Weights have half precision."""

    def __init__(self):
        self.tensors, self.operators = [], []

    def tensor(self, side, channels):
        self.tensors.append(struct.pack("<3H", side, side, channels))
        return len(self.tensors) - 1

    def add(self, kind, inputs, shape, kernel=1, stride=1, before=0, arrays=()):
        output = self.tensor(*shape)
        head = struct.pack("<6B", kind, kernel, stride, before, before, len(inputs))
        body = struct.pack(f"<{len(inputs) + 1}H", *inputs, output)
        data = (b"\x01" + array.detach().numpy().astype("<f2").tobytes() for array in arrays)
        self.operators.append(b"".join([head, body, *data]))
        return output

    def content(self, source, output):
        ends = (struct.pack("<HB", tensor, len(name)) + name for tensor, name in ((source, b"picture"), (output, b"values")))
        body = struct.pack("<HHH", len(self.tensors), len(self.operators), 1)
        body += b"".join([*self.tensors, *ends, *self.operators])
        return b"fwnet\0\0\0" + struct.pack("<II", 2, zlib.crc32(body)) + body


def folded(convolution, scale):
    """Returns the weights (out, rows, columns, in) and the bias of a convolution with the scale that follows it."""
    factor = scale.weight / torch.sqrt(scale.running_var + scale.eps)
    weights = convolution.weight * factor[:, None, None, None]
    return weights.permute(0, 2, 3, 1), scale.bias - scale.running_mean * factor


def write_blocks(writer, x, side, before, blocks, shapes):
    """Writes blocks that read the tensor `x`, and returns the last tensor, its side and its channels."""
    for block, (stride, channels) in zip(blocks, shapes):
        side //= stride
        depthwise = [block.depthwise.weight[:, 0].permute(1, 2, 0), torch.zeros(before)]
        y = writer.add(DEPTHWISE, [x], (side, before), 3, stride, 2 - stride, depthwise)
        y = writer.add(CONVOLUTION, [y], (side, channels), arrays=folded(block.pointwise, block.scale))
        if stride == 2:
            x = writer.add(MAX_POOL, [x], (side, before), 2, 2)
        if channels > before:
            x = writer.add(PAD_CHANNELS, [x], (side, channels))
        x = writer.add(ADD, [y, x], (side, channels))
        x = writer.add(PRELU, [x], (side, channels), arrays=[block.activation.weight])
        before = channels
    return x, side, before


def network(eye):
    """Returns the content of the network's file."""
    writer, side = Writer(), SIDE // 2
    source = writer.tensor(SIDE, 1)
    x = writer.add(CONVOLUTION, [source], (side, CHANNELS), 5, 2, 1, folded(eye.stem, eye.scale))
    x = writer.add(PRELU, [x], (side, CHANNELS), arrays=[eye.activation.weight])
    x, side, _ = write_blocks(writer, x, side, CHANNELS, eye.blocks, BLOCKS)
    last = [eye.values.weight.permute(0, 2, 3, 1), eye.values.bias]
    return writer.content(source, writer.add(CONVOLUTION, [x], (1, VALUES), side, arrays=last))


def table(gaze, content):
    """Returns the text of the layer's table, with the checksum that the file of the network contains."""
    weights = gaze.sums.weight.detach().numpy().T.copy()
    offsets = gaze.sums.bias.detach().numpy().copy()
    weights[:len(INPUTS)] /= gaze.deviation.numpy()[:, None]
    offsets -= gaze.mean.numpy() @ weights[:len(INPUTS)]
    weights[:, :2], offsets[:2] = 10 * weights[:, :2] * GAINS, 10 * offsets[:2] * GAINS
    outputs = 10 * gaze.outputs.weight.detach().numpy().T * GAINS
    text = lambda number: np.format_float_positional(number, 3, unique=False, fractional=False, trim="0")
    row = lambda numbers: "[" + ", ".join(text(number) if abs(number) >= 1e-4 else "0.0" for number in numbers) + "]"
    rows = lambda array: "[" + ", ".join(map(row, array)) + "]"
    checksum, = struct.unpack_from("<I", content, 12)
    lines = ["[eyes]", f"network = {checksum}", f"offsets = {row(offsets)}", f"outputs = {rows(outputs)}",
             f"values = {rows(weights[len(INPUTS):])}", "", "[eyes.inputs]"]
    return "\n".join(lines + [f"{name} = {row(own)}" for name, own in zip(INPUTS, weights)]) + "\n"


def main():
    """Trains, judges, and writes both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archives", nargs="+", type=pathlib.Path, metavar="FACES.npz")
    parser.add_argument("--epochs", type=int, default=14, help="passes over the pictures (default: 14)")
    parser.add_argument("--network", type=pathlib.Path, default=ROOT / "models/eyes.fwnet")
    parser.add_argument("--model", type=pathlib.Path, default=ROOT / "models/blendshapes.toml")
    arguments = parser.parse_args()
    text = arguments.model.read_text()
    faces = Faces(arguments.archives)
    gaze = train(faces, arguments.epochs)
    judge(gaze, faces)
    content = network(gaze.eye)
    arguments.network.write_bytes(content)
    others = re.sub(r"\n\[eyes\]\n.*?(?=\n\[(?!eyes)|\Z)", "", text, flags=re.DOTALL)
    arguments.model.write_text(others.rstrip("\n") + "\n\n" + table(gaze, content))


if __name__ == "__main__":
    main()
