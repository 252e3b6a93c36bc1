"""The landmarks of the face by their numbers."""

import array
import math
import struct
import sys
import zipfile

from .canvas import LARGE, SMALL, Drawing

LANDMARKS = 478
FACES = "fit/tests/faces.npz"

# Landmarks that programs use most, by the part of the face. Left and right are the person's own.
LIPS_OUTER = (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146)
LIPS_INNER = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
RIGHT_EYE = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
LEFT_EYE = (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249)
RIGHT_BROW = (70, 63, 105, 66, 107)
LEFT_BROW = (300, 293, 334, 296, 336)
RIGHT_IRIS, LEFT_IRIS = (469, 470, 471, 472), (474, 475, 476, 477)
OVAL = (10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150, 136,
        172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109)


def numbers_of(archive, name):
    """Returns the 16-bit numbers of a member of a file of arrays."""
    content = archive.read(f"{name}.npy")
    (header,) = struct.unpack("<H", content[8:10])
    numbers = array.array("h", content[10 + header:])
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def unit(vector):
    """Returns a vector of length 1."""
    length = sum(value * value for value in vector) ** 0.5
    return [value / length for value in vector]


def dot(a, b):
    """Returns the scalar product."""
    return sum(one * other for one, other in zip(a, b))


def upright(points):
    """Returns x and y of a face turned to the camera: the outer corners of the eyes are 1 apart, and (0, 0) is between them."""
    right, left, top, chin = (points[index] for index in (33, 263, 10, 152))
    across = [b - a for a, b in zip(right, left)]
    width = dot(across, across) ** 0.5
    x_axis = unit(across)
    down = [b - a for a, b in zip(top, chin)]
    y_axis = unit([value - dot(down, x_axis) * axis for value, axis in zip(down, x_axis)])
    middle = [(a + b) / 2 for a, b in zip(right, left)]
    moved = ([value - origin for value, origin in zip(point, middle)] for point in points)
    return [(dot(point, x_axis) / width, dot(point, y_axis) / width) for point in moved]


def mean_face(root):
    """Returns x and y of each landmark, as the mean of the neutral faces that tests of the project use."""
    with zipfile.ZipFile(root / FACES) as archive:
        numbers = numbers_of(archive, "landmarks")
        neutral = [row for row, flag in enumerate(numbers_of(archive, "neutral")) if flag]
    faces = []
    for row in neutral:
        face = numbers[row * LANDMARKS * 3:(row + 1) * LANDMARKS * 3]
        faces.append(upright([face[3 * index:3 * index + 3] for index in range(LANDMARKS)]))
    return [tuple(sum(face[index][axis] for face in faces) / len(faces) for axis in (0, 1)) for index in range(LANDMARKS)]


class View:
    """A part of the face, enlarged: a scale and where the point between the eyes lies."""

    def __init__(self, d, face, scale, x, y):
        self.d, self.face, self.scale, self.x, self.y = d, face, scale, x, y

    def at(self, index):
        """Returns where a landmark lies."""
        x, y = self.face[index]
        return self.x + self.scale * x, self.y + self.scale * y

    def dots(self, indices, width):
        """Draws landmarks as small dots, all in one path."""
        path = "".join("M{:.0f} {:.0f}h0".format(*self.at(index)) for index in indices)
        self.d.add(f'<path class="grey" d="{path}" style="stroke-width:{width}"/>')

    def ring(self, indices, colour, closed=True):
        """Draws a line through landmarks, with a dot on each."""
        path = "L".join("{:.1f} {:.1f}".format(*self.at(index)) for index in indices)
        self.d.shape("M" + path + ("z" if closed else ""), colour, width=2)
        dots = "".join("M{:.1f} {:.1f}h0".format(*self.at(index)) for index in indices)
        self.d.add(f'<path class="{colour}" d="{dots}" style="stroke-width:9"/>')

    def iris(self, edge, centre):
        """Draws an iris as a circle, with a dot on each landmark."""
        x, y = self.at(centre)
        radius = sum(math.dist((x, y), self.at(index)) for index in edge) / len(edge)
        self.d.circle(x, y, radius, "green", width=2)
        for index in (*edge, centre):
            self.d.dot(*self.at(index), 5, "green")

    def beside(self, index, x, y, colour, line=False):
        """Writes the number of a landmark with its middle at (x, y) from it."""
        at_x, at_y = self.at(index)
        if line:
            self.d.line([(at_x, at_y), (at_x + 0.6 * x, at_y + 0.6 * y)], colour, 2)
        self.d.label(at_x + x, at_y + y + 6, str(index), colour, "middle", SMALL, bold=True, halo=True)

    def row(self, indices, y, step, colours):
        """Writes the numbers of landmarks in a row around the middle of them, with lines to them."""
        below = y > self.at(indices[0])[1]
        places = sorted(indices, key=lambda index: self.at(index)[0])
        middle = sum(self.at(index)[0] for index in places) / len(places)
        for place, index in enumerate(places):
            x = middle + (place - (len(places) - 1) / 2) * step
            colour = colours.get(index, colours[None])
            self.d.line([self.at(index), (x, y - 18 if below else y + 6)], colour, 2)
            self.d.label(x, y, str(index), colour, "middle", SMALL, bold=True)


def apart(face, opening):
    """Returns a face whose lower lip is moved down, so that both edges of the lips can be seen."""
    moved = list(face)
    left, right = face[61][0], face[291][0]
    for index in LIPS_OUTER[11:] + LIPS_INNER[11:]:
        x, y = face[index]
        share = (2 * x - left - right) / (right - left)
        moved[index] = x, y + opening * (1 - share * share)
    return moved


def whole(d, face):
    """Draws the whole face, with the numbers of the oval, the brows and the nose."""
    view = View(d, face, 296, 360, 262)
    view.dots(range(LANDMARKS), 4)
    d.lines_of_text(24, 48, ["own", "right"], "grey")
    d.lines_of_text(696, 48, ["own", "left"], "grey", "end")
    for ring, colour in ((RIGHT_EYE, "blue"), (LEFT_EYE, "blue"), (LIPS_OUTER, "red"), (OVAL, "ink")):
        view.ring(ring, colour)
    for ring in (RIGHT_BROW, LEFT_BROW):
        view.ring(ring, "amber", closed=False)
    middle_x, middle_y = 360, view.at(234)[1] + 40
    for index in [index for index in OVAL if index not in (176, 400)]:
        x, y = view.at(index)
        away = ((x - middle_x) ** 2 + (y - middle_y) ** 2) ** 0.5
        view.beside(index, 31 * (x - middle_x) / away, 24 * (y - middle_y) / away, "ink")
    for index, x, y in ((70, 4, 20), (63, -10, -17), (105, -4, -20), (66, 0, -20), (107, 4, -20)):
        view.beside(index, x, y, "amber")
    for index, x, y in ((300, -4, 20), (293, 5, -16), (334, 6, -20), (296, 0, -20), (336, -4, -20)):
        view.beside(index, x, y, "amber")
    for index, x, y in ((168, 0, -20), (6, 16, 0), (4, 16, -2), (1, 16, 4), (98, -28, 4), (327, 28, 4), (2, 0, 20)):
        d.dot(*view.at(index), 5, "green")
        view.beside(index, x, y, "green")


def eye(d, face, name, x, ring, iris, centre):
    """Draws an eye with all its numbers."""
    middle = sum(face[index][0] for index in ring) / len(ring)
    view = View(d, face, 820, x - 820 * middle, 872)
    view.ring(ring, "blue")
    view.iris(iris, centre)
    d.label(x, 738, name, "ink", "middle", LARGE, bold=True)
    top, bottom = iris[1], iris[3]
    corners = [ring[0], ring[8]]
    view.row([*ring[1:8], top], 790, 42, {None: "blue", top: "green"})
    view.row([*ring[9:], bottom], 974, 42, {None: "blue", bottom: "green"})
    for index in corners:
        side = 1 if view.at(index)[0] > x else -1
        view.beside(index, side * 25, 0, "blue")
    view.beside(centre, 0, 20, "green")
    for index in (iris[0], iris[2]):
        side = 1 if view.at(index)[0] < view.at(centre)[0] else -1
        view.beside(index, side * 26, 0, "green")


def lips(d, face):
    """Draws the lips with their numbers, a little apart."""
    view = View(d, apart(face, 0.16), 820, 360, 540)
    view.ring(LIPS_OUTER, "red")
    view.ring(LIPS_INNER, "blue")
    d.label(360, 1036, "Lips, drawn apart", "ink", "middle", LARGE, bold=True)
    view.row(LIPS_OUTER[1:10], 1086, 58, {None: "red"})
    view.row(LIPS_OUTER[11:], 1458, 58, {None: "red"})
    for index, x in ((61, -26), (291, 28)):
        view.beside(index, x, 0, "red")
    for index, x, y in ((78, 52, 24), (308, -52, 24), (81, 4, 24), (82, 4, 24), (13, 0, 22), (312, -4, 24), (311, -4, 24),
                        (178, 14, -22), (87, 6, -24), (14, 0, -24), (317, -6, -24), (402, -14, -22)):
        view.beside(index, x, y, "blue", line=index in (78, 308))


def landmarks(root):
    """The face mesh with the numbers that people need."""
    d = Drawing(
        "landmarks", 1490, "The landmarks of the face by their numbers",
        "The 478 landmarks of a face at rest, with the numbers of those that programs use most: the oval of the face from 10"
        " at the top to 152 at the chin, brows, nose with its tip 4, both eyes with the irises 468 and 473, and lips. The"
        " person's own right side is at the left of the drawing.",
    )
    face = mean_face(root)
    whole(d, face)
    eye(d, face, "Right eye", 182, RIGHT_EYE, RIGHT_IRIS, 468)
    eye(d, face, "Left eye", 538, LEFT_EYE, LEFT_IRIS, 473)
    lips(d, face)
    return d
