"""Heads before cameras, and the horn of a servo."""

import math

from .canvas import LARGE, SMALL, Drawing, number
from .person import profile


def drawings():
    """Returns the drawings of this file."""
    return [mount(), light(), horn()]


def camera(d, x, y, degrees=0, upside_down=False):
    """Draws a camera whose lens is at (x, y) and looks to the right, with its foot below it, or above it."""
    foot = -1 if upside_down else 1
    d.add(f'<g transform="translate({x} {y}) rotate({degrees})">')
    d.add('<rect class="ink f-blue" x="-42" y="-20" width="32" height="40" rx="6"/>')
    d.shape("M-10-9L6-15V15L-10 9z", "ink", "blue")
    d.shape(f"M-26 {foot * 20}v{foot * 16}M-40 {foot * 36}h28", "ink", width=5)
    d.add("</g>")


def lamp(d, x, y, degrees=0):
    """Draws a lamp that shines downwards from (x, y)."""
    d.add(f'<g transform="translate({x} {y}) rotate({degrees})">')
    d.shape("M-34 24L-18-12H18L34 24z", "ink", "glow")
    d.shape("M-16 42V58M20 42L26 57", "amber", width=5)
    d.add("</g>")


def window(d, x, y, width, height):
    """Draws a bright window."""
    d.add(f'<rect class="ink f-glow" x="{x}" y="{y}" width="{width}" height="{height}"/>')
    d.shape(f"M{x + width / 2} {y}v{height}M{x} {y + height / 2}h{width}", "ink")


def mount():
    """How a camera is mounted: well and poorly."""
    d = Drawing(
        "mount", 420, "How the camera is mounted",
        "Two heads with a camera each. Good: the camera stands upright, at the height of the eyes, an arm's length away, with"
        " light from the front. Poor: the camera hangs upside down, far below the eyes, with a window behind the head.",
    )
    d.shape("M360 24V396", "frame", width=2)
    lamp(d, 74, 62, -48)
    camera(d, 82, 156)
    d.shape("M56 192V270M24 270H88", "ink", width=5)
    profile(d, 236, 156)
    d.line([(104, 156), (206, 156)], "green", 4, dashed=True)
    d.tick(38, 316)
    d.lines_of_text(64, 320, ["Good: upright, as high as", "the eyes, at arm's length,", "light from the front"], "green")
    window(d, 628, 40, 72, 170)
    profile(d, 560, 136, dark=True)
    camera(d, 434, 232, -42, upside_down=True)
    d.line([(450, 216), (532, 156)], "red", 4, dashed=True)
    d.cross(398, 314, 11)
    d.lines_of_text(422, 320, ["Poor: upside down, from", "far below, with a window", "behind the head"], "red")
    return d


def light():
    """Light, distance and the height of the camera."""
    d = Drawing(
        "light", 740, "Light, distance and height of the camera",
        "Above, good: a lamp stands behind the screen and lights the face from the front, the camera on the screen is as high"
        " as the eyes, and the face is an arm's length away. Below, poor: a window behind the head; the camera far below the"
        " eyes; a dark room, with the face far away.",
    )
    d.tick(44, 48)
    d.label(70, 54, "Good", "green", bold=True, size=LARGE)
    d.shape("M72 132V310M42 310h60", "ink", width=5)
    lamp(d, 84, 112, -80)
    d.shape("M172 186L162 310M140 310h60", "ink", width=5)
    d.add('<rect class="ink f-fill" x="188" y="172" width="16" height="120" rx="4" transform="rotate(4 196 232)"/>')
    camera(d, 208, 150)
    profile(d, 530, 150, 1.15)
    d.line([(226, 150), (494, 150)], "green", 4, dashed=True)
    d.label(355, 134, "as high as the eyes", "green", "middle")
    d.line([(224, 272), (494, 272)], "green", 4)
    d.head((494, 272), (224, 272), "green")
    d.head((224, 272), (494, 272), "green")
    d.label(355, 258, "arm's length", "green", "middle")
    d.label(24, 362, "lamp behind the screen, light from the front", "amber")
    d.shape("M24 398H696", "frame", width=2)
    d.cross(42, 438, 11)
    d.label(70, 446, "Poor", "red", bold=True, size=LARGE)
    # A window behind the head.
    window(d, 182, 476, 60, 150)
    profile(d, 122, 546, 0.82, dark=True)
    camera(d, 68, 546)
    d.lines_of_text(130, 686, ["window", "behind the head"], "red", "middle")
    # The camera is far below.
    profile(d, 372, 524, 0.82)
    camera(d, 304, 632, -48)
    d.line([(321, 612), (354, 566)], "red", 4, dashed=True)
    d.lines_of_text(374, 712, ["camera far below"], "red", "middle")
    # Dark and far.
    d.box(488, 476, 208, 180, None, "night", 12)
    camera(d, 548, 556)
    profile(d, 648, 556, 0.42, dark=True)
    d.lines_of_text(592, 686, ["dark, or", "far away"], "red", "middle")
    return d


def linkage(d, x, degrees, colour):
    """Draws a servo whose horn is turned by an angle, and a rod from the horn to the lever of a jaw."""
    y, length, servo, pivot = 222, 84, x + 54, x - 34
    shift, height = length * math.sin(math.radians(degrees)), length * math.cos(math.radians(degrees))
    d.box(servo - 34, y - 26, 68, 116, "ink", "fill", 6)
    for side in (-1, 1):
        d.shape(f"M{servo + side * 34} {y + 10}h{side * 16}v14h{-side * 16}", "ink", "fill")
    # Teeth and bone above, and below those that turn with the lever.
    d.shape(f"M{pivot - 66} {y - 8}h66v-20h-66zM{pivot - 60} {y - 8}v7m12-7v7m12-7v7", "ink", "skin")
    d.add(f'<g transform="rotate({number(degrees - OPEN_DEG)} {pivot} {y})">')
    d.shape(f"M{pivot - 66} {y + 6}h66v20h-50q-16 0-16-20zM{pivot - 60} {y + 6}v-5m12 5v-5m12 5v-5", "ink", "skin")
    d.add("</g>")
    d.shape(f"M{servo} {y - 16}V{y - 118}", "grey", width=2, dashed=True)
    d.shape(f"M{pivot} {y}L{number(pivot + shift)} {number(y - height)}", "grey", width=14)
    d.shape(f"M{servo} {y}L{number(servo + shift)} {number(y - height)}", colour, width=18)
    d.shape(f"M{number(pivot + shift)} {number(y - height)}H{number(servo + shift)}", "ink", width=6)
    if degrees == 0:
        d.shape(f"M{servo - 24} {number(y - height + 4)}v20h16", "blue", width=3)
    for end in (pivot, servo):
        d.circle(end + shift, y - height, 6, "ink", "plate")
    d.circle(pivot, y, 7, "ink", "plate")
    d.circle(servo, y, 17, "ink", "plate")
    d.dot(servo, y, 5)


OPEN_DEG = 26


def horn():
    """A servo's horn in the middle and at both ends."""
    d = Drawing(
        "horn", 516, "The horn of a servo in the middle and at both ends",
        "Three times the same servo with a rod to a jaw. At end 0 the jaw is shut, and at end 1 it is open. In the middle,"
        " horn and rod make a right angle: fasten the horn there, so that it turns by the same angle to either side. Both ends"
        " are set on the page before the servo binds.",
    )
    cases = (
        (OPEN_DEG, "End 0", "jaw shut", "Set end 0 here", "amber"),
        (0, "Middle", "fasten the horn", "right angle", "blue"),
        (-OPEN_DEG, "End 1", "jaw open", "Set end 1 here", "amber"),
    )
    for place, (degrees, name, first, second, colour) in enumerate(cases):
        x = 128 + 232 * place
        d.label(x, 52, name, colour, "middle", LARGE, bold=True)
        linkage(d, x, degrees, colour)
        d.label(x, 362, first, "ink", "middle")
        if degrees:
            d.plate(x, 402, second, "blue", SMALL)
        else:
            d.label(x, 394, second, "blue", "middle")
    advice = ["The same angle to both sides. Stop before the", "servo binds, and set the end there on the page."]
    d.lines_of_text(24, 464, advice, "grey")
    return d
