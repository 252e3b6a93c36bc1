"""Drawings whose subject is a face: poses, sides, angles, and the servos of a head."""

from .canvas import LARGE, Drawing, number as n
from .person import head


def drawings():
    """Returns the drawings of this file."""
    return [poses(), left_right(), servos_of_a_head()]


POSES = (
    ("at rest", {}),
    ("eyes shut", {"eyeBlinkLeft": 1, "eyeBlinkRight": 1}),
    ("mouth wide open", {"jawOpen": 1}),
    ("brows up", {"browUp": 1}),
    ("brows down", {"browDown": 1}),
    ("smile", {"mouthSmile": 1}),
    ("pucker", {"mouthPucker": 1}),
    ("look to your left", {"look": (1, 0)}),
    ("look to your right", {"look": (-1, 0)}),
    ("look up", {"look": (0, 1)}),
    ("look down", {"look": (0, -1)}),
)


def poses():
    """The poses of a calibration, in their order."""
    d = Drawing(
        "poses", 1020, "The eleven poses of a calibration",
        "Eleven faces: at rest, eyes shut, mouth wide open, brows up, brows down, smile, pucker, and looks to your left, to"
        " your right, up and down with the eyes alone.",
    )
    for place, (name, expression) in enumerate(POSES):
        x, y = 128 + place % 3 * 232, 118 + place // 3 * 248
        head(d, x, y, 0.88, **expression)
        d.badge(x - 92, y - 78, str(place + 1), "blue")
        d.label(x, y + 128, name, "ink", "middle")
    d.lines_of_text(494, 850, ["Face the camera.", "Looks: with the", "eyes alone, the", "head stays still."], "grey")
    return d


def left_right():
    """Own left and right, mirror images, and the signs of the head's angles."""
    d = Drawing(
        "left-right", 860, "Left, right and the angles of the head",
        "You wink your left eye, which is at the right in the camera's picture: eyeBlinkLeft. An avatar that faces you winks"
        " its own left eye, as another person would. With mirror = true, it winks on the other side, like a mirror. Below: yaw"
        " is positive when you turn to your left, pitch when you look up, and roll when you tilt the head to your right"
        " shoulder.",
    )
    d.label(24, 48, "Left is your own left: eyeBlinkLeft", bold=True, size=LARGE)
    columns = (("you, as the", "camera sees you"), ("avatar,", "by default"), ("avatar with", "mirror = true"))
    for place, lines in enumerate(columns):
        x = 128 + 232 * place
        wink = {"eyeBlinkRight": 1} if place == 2 else {"eyeBlinkLeft": 1}
        head(d, x, 178, 0.95, **wink)
        d.lines_of_text(x, 316, lines, "ink", "middle")
        side = -1 if place == 2 else 1
        d.line([(x + side * 100, 118), (x + side * 50, 156)], "red", 4, arrow=True)
    d.label(24, 412, "Angles of the head: these are positive", bold=True, size=LARGE)
    head(d, 128, 540, 0.95, turn=1, tilt_deg=0)
    head(d, 360, 540, 0.95, nod=1)
    head(d, 592, 540, 0.95, tilt_deg=-16)
    arc(d, [(88, 650), (128, 668), (176, 648)])
    arc(d, [(452, 590), (468, 545), (452, 495)])
    arc(d, [(632, 450), (592, 432), (546, 446)])
    for x, name, direction in ((128, "yaw", "to your left"), (360, "pitch", "up"), (592, "roll", "to your right")):
        d.label(x, 710, name, "blue", "middle", bold=True, size=LARGE)
        d.label(x, 738, direction, "ink", "middle")
    d.label(592, 764, "shoulder", "ink", "middle")
    # The axes of the packet.
    d.lines_of_text(24, 800, ["Axes of the packet: x to your left, y up,", "z out of the face"], "grey")
    return d


def arc(d, points):
    """Draws a curved arrow through three points."""
    (x, y), (by_x, by_y), (end_x, end_y) = points
    control = 2 * by_x - (x + end_x) / 2, 2 * by_y - (y + end_y) / 2
    d.shape(f"M{n(x)} {n(y)}Q{n(control[0])} {n(control[1])} {n(end_x)} {n(end_y)}", "blue", width=5)
    d.head(control, (end_x, end_y), "blue", 16)


SERVOS = (
    (("1",), "eyes, sideways", "eyeLookOut, eyeLookIn"),
    (("2",), "eyes, up", "eyeLookUp, eyeLookDown"),
    (("3", "4"), "upper lids", "eyeBlink, eyeWide, eyeLookDown"),
    (("5", "6"), "lower lids", "eyeBlink, eyeSquint"),
    (("7", "8"), "brows", "browInnerUp, browDown"),
    (("9",), "jaw", "jawOpen, mouthClose"),
    (("10",), "neck, turning", "headYaw"),
    (("11", "12"), "neck, nodding", "headPitch, headRoll"),
)


def servos_of_a_head():
    """An animatronic head with its servos by number, and what each follows."""
    d = Drawing(
        "head", 900, "The servos of an animatronic head",
        "A head from the front with twelve servos: 1 turns both eyes sideways, 2 up and down, 3 and 4 move the upper lids, 5"
        " and 6 the lower lids, 7 and 8 the brows, 9 the jaw, 10 turns the neck, and 11 and 12 nod it left and right. A table"
        " names the coefficients and angles that each follows.",
    )
    x = 360
    # Neck with two rods on a turntable.
    d.shape(f"M{x - 70} 478h140", "ink", width=14)
    d.box(x - 22, 380, 44, 90, corner=4)
    for side in (-1, 1):
        d.shape(f"M{x + side * 62} 470L{x + side * 52} 372", "grey", width=9)
    middle = f"translate({x})"
    skull = "M-130 180C-136 20 136 20 130 180C130 250 112 310 96 330H-96C-112 310-130 250-130 180z"
    d.shape(skull, "ink", "fill", transform=middle)
    chin = "M-100 318C-84 380-40 406 0 406C40 406 84 380 100 318L60 318Q0 346-60 318z"
    d.shape(chin, "ink", "plate", transform=middle)
    d.dot(x - 100, 300, 8, "grey")
    d.dot(x + 100, 300, 8, "grey")
    d.shape(f"M{x - 62} 306Q{x} 322 {x + 62} 306", "lip", width=8)
    d.shape(f"M{x - 56} 326Q{x} 350 {x + 56} 326", "lip", width=8)
    d.shape(f"M{x - 30} 176H{x + 30}", "grey", width=9)
    d.shape(f"M{x + 6} 218C{x + 8} 226 {x + 18} 240 {x + 14} 250Q{x} 262 {x - 14} 250", "ink")
    for side in (-1, 1):
        eye_x = x + side * 58
        d.circle(eye_x, 176, 32, "ink", "white")
        d.circle(eye_x, 176, 15, "blue", "blue")
        d.dot(eye_x, 176, 7, "dark")
        d.shape(f"M{eye_x - 36} 160A38 38 0 0 1 {eye_x + 36} 160Q{eye_x} 146 {eye_x - 36} 160z", "ink", "skin")
        d.shape(f"M{eye_x - 34} 194A38 38 0 0 0 {eye_x + 34} 194Q{eye_x} 204 {eye_x - 34} 194z", "ink", "skin")
        d.shape(f"M{eye_x - side * 34} 122Q{eye_x} 100 {eye_x + side * 38} 118", "hair", width=11)
    servo_numbers(d, x)
    for row, (numbers, name, sources) in enumerate(SERVOS):
        y = 560 + 42 * row
        for place, number in enumerate(numbers):
            d.badge(42 + 40 * place, y - 7, number, "blue")
        d.label(118, y, name, bold=True)
        d.label(330, y, sources, size=19)
    return d


def servo_numbers(d, x):
    """Puts numbers beside the parts of the head, with lines to them."""
    marks = (
        ("7", x + 210, 84, x + 92, 112), ("8", x - 210, 84, x - 92, 112),
        ("3", x + 210, 138, x + 92, 156), ("4", x - 210, 138, x - 92, 156),
        ("5", x + 210, 212, x + 94, 202), ("6", x - 210, 212, x - 94, 202),
        ("9", x + 210, 366, x + 76, 366), ("11", x + 210, 436, x + 66, 436), ("12", x - 210, 436, x - 66, 436),
        ("10", x - 210, 492, x - 82, 480),
    )
    for number, badge_x, badge_y, end_x, end_y in marks:
        d.line([(badge_x, badge_y), (end_x, end_y)], "blue", 3)
        d.badge(badge_x, badge_y, number, "blue")
    d.badge(x, 148, "2", "blue", 14)
    d.badge(x, 202, "1", "blue", 14)
    d.label(x - 240, 56, "its right", "grey", "start")
    d.label(x + 240, 56, "its left", "grey", "end")
