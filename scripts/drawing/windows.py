"""Where to click in the programs that receive the face."""

import math

from .canvas import LARGE, SMALL, Drawing, path_of, text_width


def drawings():
    """Returns the drawings of this file."""
    return [vseeface(), vrchat(), unreal()]


def settings(d, lines, program):
    """Draws the settings of facewire's link at the top, and says whose address it is."""
    d.badge(44, 46, "1", "blue")
    d.label(72, 53, "Settings of facewire", bold=True, size=LARGE)
    lines = ["[[link]]", *lines]
    height = 22 + 30 * len(lines)
    d.box(24, 78, 672, height, "grey", "fill")
    for place, text in enumerate(lines):
        d.label(44, 110 + 30 * place, text, mono=True)
    y = 78 + height + 32
    d.label(24, y, f"the address is that of the machine with {program}", "grey")
    return y


def window(d, x, y, width, height, title):
    """Draws an empty window with a title."""
    d.box(x, y, width, height, "ink", "plate", 10)
    d.shape(f"M{x} {y + 44}h{width}", "ink", width=2)
    d.label(x + 18, y + 30, title, bold=True)
    for place in range(3):
        d.dot(x + width - 24 - 22 * place, y + 22, 6, "grey")


def tick_box(d, x, y, text):
    """Draws a box with a tick, and its text."""
    d.box(x, y - 20, 26, 26, "blue", "plate", 4)
    d.shape(f"M{x + 6} {y - 8}l6 8l10-14", "blue", width=4)
    d.label(x + 40, y, text)


def field(d, x, y, name, value, width=130, menu=False):
    """Draws a field with its name before it."""
    d.label(x, y, name)
    d.box(x + 190, y - 26, width, 38, "grey", "fill", 6, stroke=2)
    d.label(x + 204, y, value, "blue", bold=True)
    if menu:
        d.label(x + 190 + width - 12, y, "▾", "grey", "end")


def menus(d, y, number, parts):
    """Draws the way through menus: each part in a box, with an arrow between two."""
    x = 72
    d.badge(44, y - 7, number, "blue")
    for place, text in enumerate(parts):
        width = text_width(text, SMALL + 1) + 26
        d.box(x, y - 30, width, 46, "blue", "fill", 8)
        d.label(x + width / 2, y, text, "ink", "middle", SMALL + 1)
        x += width
        if place + 1 < len(parts):
            d.line([(x + 6, y - 7), (x + 30, y - 7)], "blue", 4, arrow=True)
            x += 38


def vseeface():
    """Where VSeeFace is switched to receive."""
    d = Drawing(
        "vseeface", 640, "Where to switch VSeeFace to receive",
        "First, a link of the kind vmc in the settings of facewire, with the address of the machine with VSeeFace and the"
        " port 39540. Second, in VSeeFace, General settings. Third, under OSC/VMC protocol, enable the receiver with the port"
        " 39540.",
    )
    settings(d, ['kind = "vmc"', 'address = "192.168.1.20:39540"'], "VSeeFace")
    menus(d, 300, "2", ["General settings", "OSC/VMC protocol"])
    window(d, 72, 346, 624, 216, "VSeeFace: General settings")
    d.badge(44, 440, "3", "blue")
    d.label(96, 424, "OSC/VMC protocol", "grey")
    tick_box(d, 96, 472, "receiver")
    field(d, 96, 526, "port", "39540")
    d.line([(436, 520), (480, 520)], "blue", 4)
    d.head((480, 520), (436, 520), "blue")
    d.lines_of_text(494, 514, ["the same port", "as in 1"], "blue")
    d.label(24, 610, "The avatar needs the 52 blendshapes of Perfect Sync.", "grey")
    return d


def ring_menu(d, x, y, name):
    """Draws a round menu of six parts, of which the upper one is chosen."""
    inner, outer = 34, 92

    def spoke(degrees):
        across, down = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return [(x + radius * across, y + radius * down) for radius in (inner, outer)]

    d.circle(x, y, outer, "ink", "fill")
    for degrees in (30, 90, 150):
        d.shape(path_of(spoke(degrees)), "grey", width=2)
    (right_in, right), (left_in, left) = spoke(-30), spoke(-150)
    start, end, back = path_of([left_in, left]), path_of([right, right_in])[1:], path_of([left_in])[1:]
    d.shape(f"{start}A{outer} {outer} 0 0 1 {end}A{inner} {inner} 0 0 0 {back}z", "blue", "plate", width=4)
    d.circle(x, y, inner, "ink", "plate")
    d.label(x, y - 52, name, "blue", "middle", bold=True)


def vrchat():
    """Where VRChat is switched to receive."""
    d = Drawing(
        "vrchat", 640, "Where to switch VRChat to receive",
        "First, a link of the kind vrchat in the settings of facewire, with the address of the machine with VRChat and the"
        " port 9000. Second, in VRChat, open the action menu, then Options, then OSC, and turn on Enabled. OSC Debug shows"
        " whether messages arrive.",
    )
    settings(d, ['kind = "vrchat"', 'address = "192.168.1.20:9000"'], "VRChat")
    d.badge(44, 282, "2", "blue")
    d.label(72, 289, "In VRChat, open the action menu:", bold=True, size=LARGE)
    for place, name in enumerate(("Options", "OSC", "Enabled")):
        ring_menu(d, 130 + 230 * place, 412, name)
        if place < 2:
            d.line([(230 + 230 * place, 412), (256 + 230 * place, 412)], "blue", 5, arrow=True)
    d.tick(590, 412, 14)
    advice = [
        "Nothing moves? Options, OSC, OSC Debug shows",
        "whether messages arrive. VRCFaceTracking must not",
        "run at the same time.",
    ]
    d.lines_of_text(24, 558, advice, "grey")
    return d


def unreal():
    """Where Unreal is switched to receive."""
    d = Drawing(
        "unreal", 920, "Where to switch Unreal to receive",
        "First, a link of the kind live-link in the settings of facewire, with the address of the machine with Unreal, the"
        " port 11111 and a subject. Second, enable the plugins Live Link, Apple ARKit and Apple ARKit Face Support, and"
        " restart. Third, the subject appears under Window, Virtual Production, Live Link. Fourth, choose it as ARKit Face"
        " Subj of the MetaHuman, and tick Use ARKit.",
    )
    settings(d, ['kind = "live-link"', 'address = "192.168.1.20:11111"', 'subject = "webcam"'], "Unreal")
    d.badge(44, 334, "2", "blue")
    window(d, 72, 300, 624, 186, "Plugins")
    for place, name in enumerate(("Live Link", "Apple ARKit", "Apple ARKit Face Support")):
        tick_box(d, 96, 382 + 40 * place, name)
    d.lines_of_text(520, 382, ["then restart", "Unreal"], "blue")
    menus(d, 542, "3", ["Window", "Virtual Production", "Live Link"])
    window(d, 72, 576, 624, 100, "Live Link")
    d.dot(110, 647, 9, "green")
    d.label(130, 654, "webcam", "blue", bold=True)
    d.label(240, 654, "appears by itself", "grey")
    d.badge(44, 738, "4", "blue")
    window(d, 72, 708, 624, 180, "Details of the MetaHuman")
    field(d, 96, 794, "ARKit Face Subj", "webcam", 200, menu=True)
    tick_box(d, 96, 854, "Use ARKit")
    return d
