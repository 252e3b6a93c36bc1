"""What all drawings share: the colours, the signs of wiring, and a check that no text lies on other text or on a line.

Coordinates are pixels of a drawing that is 720 wide. A drawing is shown at half of this width on a phone, so that its text has
at least 18 pixels.
"""

import math
from html import escape

WIDTH = 720
MARGIN = 10
LARGE, TEXT, SMALL = 22, 20, 18

# The name of each colour, on a white page and on a dark one.
COLOURS = {
    "plate": ("#ffffff", "#161b22"),
    "frame": ("#c9d1d9", "#3d444d"),
    "ink": ("#1f2933", "#e6edf3"),
    "grey": ("#59636e", "#a3aebb"),
    "fill": ("#eef2f6", "#262d36"),
    "red": ("#c4232f", "#ff7b72"),
    "blue": ("#0b5fd0", "#6cb0ff"),
    "green": ("#16793a", "#4cc962"),
    "amber": ("#9a6200", "#e8b04a"),
    "skin": ("#f7e4d4", "#5a4a42"),
    "white": ("#ffffff", "#f0f3f6"),
    "dark": ("#1f2933", "#10151b"),
    "glow": ("#ffe9a8", "#c9a544"),
    "shade": ("#59636e", "#343c46"),
    "night": ("#3d4753", "#0a0d12"),
    "hair": ("#6a5342", "#2a211c"),
    "lip": ("#c2584e", "#e58f85"),
}

# The widths of characters in DejaVu Sans, the widest of the usual fonts, as parts of the size of the text.
CHARACTERS = {
    0.30: "Iijl'|J", 0.34: " .,:;/\\", 0.40: "()[]-ftr", 0.56: "Lcszk\"_",
    0.64: "aegyvxTFPEY0123456789bdhnopquSµ°…–●▾",
    0.72: "AVXZKBRC?", 0.79: "DHNUGOQΩ☰", 0.86: "Mw+=<>−→×✓", 0.99: "mW%",
}
WIDTHS = {character: width for width, characters in CHARACTERS.items() for character in characters}


def style():
    """Returns the rules for both kinds of page. A class names the colour of a line, of a text or of a surface."""
    def rules(page):
        return "".join(
            f".{name}{{stroke:{colours[page]}}}.t-{name},.f-{name}{{fill:{colours[page]}}}" for name, colours in COLOURS.items()
        )

    return (
        "path,line,rect,circle,ellipse{fill:none;stroke-width:3;stroke-linecap:round;stroke-linejoin:round}"
        ".gap{stroke-width:12;stroke-linecap:butt}.halo{stroke-width:5;paint-order:stroke}"
        f"{rules(0)}@media (prefers-color-scheme:dark){{{rules(1)}}}"
    )


def number(value):
    """Returns a coordinate with at most one decimal."""
    return f"{value:.1f}".removesuffix(".0") if abs(value) >= 0.05 else "0"


def path_of(points, closed=False):
    """Returns the path of straight lines through points."""
    return "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + ("z" if closed else "")


def text_width(text, size, bold=False):
    """Returns the width of a text, or a little more."""
    return sum(WIDTHS.get(character, 0.7) for character in text) * size * (1.1 if bold else 1)


class Drawing:
    """A picture of boxes, wires and labels on a plate with round corners."""

    def __init__(self, name, height, title, description):
        self.name, self.height, self.title, self.description = name, height, title, description
        self.parts = []
        self.labels = []
        self.lines = []

    def add(self, part):
        """Adds a piece of SVG that no check looks at."""
        self.parts.append(part)

    def shape(self, path, line="ink", fill=None, width=3, dashed=False, transform=None):
        """Adds a path."""
        classes = " ".join(name for name in (line, fill and f"f-{fill}") if name)
        extra = "" if width == 3 else f' style="stroke-width:{number(width)}"'
        extra += ' stroke-dasharray="4 9"' if dashed else ""
        extra += f' transform="{transform}"' if transform else ""
        self.add(f'<path class="{classes}" d="{path}"{extra}/>')

    def circle(self, x, y, radius, line="ink", fill=None, width=3):
        """Adds a circle."""
        classes = " ".join(name for name in (line, fill and f"f-{fill}") if name)
        extra = "" if width == 3 else f' style="stroke-width:{number(width)}"'
        self.add(f'<circle class="{classes}" cx="{number(x)}" cy="{number(y)}" r="{number(radius)}"{extra}/>')

    def dot(self, x, y, radius=5, colour="ink"):
        """Adds a filled circle."""
        self.add(f'<circle class="f-{colour}" cx="{number(x)}" cy="{number(y)}" r="{number(radius)}"/>')

    def box(self, x, y, width, height, line="ink", fill="fill", corner=10, stroke=3):
        """Adds a rectangle. A text may lie inside or outside, but not on its edge."""
        classes = " ".join(name for name in (line, fill and f"f-{fill}") if name)
        extra = "" if stroke == 3 else f' style="stroke-width:{number(stroke)}"'
        self.add(
            f'<rect class="{classes}" x="{number(x)}" y="{number(y)}" width="{number(width)}" height="{number(height)}"'
            f' rx="{corner}"{extra}/>'
        )
        if line:
            corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
            self.lines += zip(corners, corners[1:])

    def label(self, x, y, text, colour="ink", anchor="start", size=TEXT, bold=False, mono=False, over=False, halo=False):
        """Adds a text whose line of writing is at `y`. Lines may run below a text that lies `over` something."""
        width = 0.61 * size * len(text) if mono else text_width(text, size, bold)
        left = x - {"start": 0, "middle": width / 2, "end": width}[anchor]
        self.labels.append((text, over, left, y - 0.76 * size, left + width, y + 0.2 * size))
        extra = "" if anchor == "start" else f' text-anchor="{anchor}"'
        extra += ' font-weight="bold"' if bold else ""
        extra += ' font-family="monospace"' if mono else ""
        extra += "" if size == TEXT else f' font-size="{number(size)}"'
        classes = f"t-{colour} plate halo" if halo else f"t-{colour}"
        self.add(f'<text class="{classes}" x="{number(x)}" y="{number(y)}"{extra}>{escape(text, quote=False)}</text>')

    def lines_of_text(self, x, y, texts, colour="ink", anchor="start", size=TEXT, bold=False, step=1.3):
        """Adds several lines of text, one below the other."""
        for place, text in enumerate(texts):
            self.label(x, y + place * size * step, text, colour, anchor, size, bold)

    def plate(self, x, y, text, colour="ink", size=TEXT, fill="fill", pad=14):
        """Adds a text in the middle of a rounded box of its size."""
        width = text_width(text, size) + 2 * pad
        self.box(x - width / 2, y - size, width, 2 * size, colour, fill, corner=10)
        self.label(x, y + 0.36 * size, text, colour, "middle", size)

    def wire(self, points, colour="ink", width=4, dashed=False, arrow=False, both=False):
        """Adds a wire through points. Where it crosses what was drawn before, a gap shows that they are not connected."""
        path = path_of(points)
        self.add(f'<path class="plate gap" d="{path}"/>')
        self.shape(path, colour, width=width, dashed=dashed)
        self.lines += zip(points, points[1:])
        if arrow or both:
            self.head(points[-2], points[-1], colour)
        if both:
            self.head(points[1], points[0], colour)

    def line(self, points, colour="ink", width=3, dashed=False, arrow=False):
        """Adds a line without a gap, such as one that leads from a label to a thing."""
        self.shape(path_of(points), colour, width=width, dashed=dashed)
        self.lines += zip(points, points[1:])
        if arrow:
            self.head(points[-2], points[-1], colour)

    def head(self, start, end, colour, size=13):
        """Adds the head of an arrow."""
        angle = math.atan2(end[1] - start[1], end[0] - start[0])
        corners = [(end[0] + 3 * math.cos(angle), end[1] + 3 * math.sin(angle))]
        for side in (2.65, -2.65):
            corners.append((end[0] + size * math.cos(angle + side), end[1] + size * math.sin(angle + side)))
        self.shape(path_of(corners, closed=True), colour, colour, width=2)

    def cross(self, x, y, size=14):
        """Adds a red cross: not like this."""
        strokes = [(x + side * size, y - size) for side in (-1, 1)], [(x + side * size, y + size) for side in (1, -1)]
        path = "".join(path_of(ends) for ends in zip(*strokes))
        self.shape(path, "plate", width=11)
        self.shape(path, "red", width=6)

    def tick(self, x, y, size=12):
        """Adds a green tick: like this."""
        corners = [(x - size, y), (x - 0.3 * size, y + 0.8 * size), (x + 0.9 * size, y - 0.8 * size)]
        self.shape(path_of(corners), "green", width=6)

    def badge(self, x, y, text, colour="ink", radius=16, size=SMALL):
        """Adds a number in a filled circle."""
        self.circle(x, y, radius, colour, colour, width=2)
        self.label(x, y + 0.36 * size, text, "plate", "middle", size, bold=True, over=True)

    def faults(self):
        """Returns what a reader could not read: texts that leave the plate, or lie on another text or on a line."""
        faults = []
        for place, (text, over, left, top, right, bottom) in enumerate(self.labels):
            if left < MARGIN or top < MARGIN or right > WIDTH - MARGIN or bottom > self.height - MARGIN:
                faults.append(f"{self.name}: {text!r} leaves the drawing: {left:.0f} to {right:.0f}, {top:.0f} to {bottom:.0f}")
            for other, _, a, b, c, d in self.labels[:place]:
                if left < c and a < right and top < d and b < bottom:
                    faults.append(f"{self.name}: {text!r} lies on {other!r}")
            if not over and any(touches(line, left - 1, top, right + 1, bottom) for line in self.lines):
                faults.append(f"{self.name}: a line runs through {text!r}")
        return faults

    def svg(self):
        """Returns the file."""
        inner = "\n".join(self.parts)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {self.height}" role="img"'
            f' aria-labelledby="title desc" font-family="sans-serif" font-size="{TEXT}">\n'
            f'<title id="title">{escape(self.title)}</title>\n<desc id="desc">{escape(self.description)}</desc>\n'
            f"<style>{style()}</style>\n"
            f'<rect class="frame f-plate" x="1" y="1" width="{WIDTH - 2}" height="{self.height - 2}" rx="16"'
            f' style="stroke-width:2"/>\n{inner}\n</svg>\n'
        )


def touches(line, left, top, right, bottom):
    """Returns whether a line enters a rectangle, by cutting the line at each of its four sides."""
    (x, y), (end_x, end_y) = line
    first, last = 0.0, 1.0
    for start, step, low, high in ((x, end_x - x, left, right), (y, end_y - y, top, bottom)):
        if abs(step) < 1e-9:
            if not low < start < high:
                return False
            continue
        one, two = sorted(((low - start) / step, (high - start) / step))
        first, last = max(first, one), min(last, two)
    return first < last
