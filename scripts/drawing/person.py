"""Heads, drawn by lines: from the front with an expression, and from the side."""

from .canvas import number as n

EYES = (-29, 29)


def head(d, x, y, size=1.0, turn=0.0, nod=0.0, tilt_deg=0.0, **expression):
    """Draws a head from the front. Its own left is at the right of the drawing.

    `turn` and `nod` shift what is in the face, from -1 to 1: positive to its own left, and up. The expression has coefficients
    from 0 to 1, of which those for one side are named as in ARKit; `look` is where the eyes look, as `turn` and `nod`.
    """
    get = expression.get
    d.add(f'<g transform="translate({n(x)} {n(y)}) scale({size:g}) rotate({n(tilt_deg)})">')
    jaw = 24 * get("jawOpen", 0)
    for side in (-1, 1):
        d.add(f'<ellipse class="ink f-skin" cx="{n(side * 70 - 7 * turn)}" cy="{n(6 * nod)}" rx="11" ry="18"/>')
    d.shape(f"M-68-20C-72-96 72-96 68-20C68 34 46 {n(94 + jaw)} 0 {n(94 + jaw)}C-46 {n(94 + jaw)}-68 34-68-20z", "ink", "skin")
    hair = n(-54 - 12 * nod)
    fringe = f"{n(30 + 8 * turn)} {hair}C0 {n(-48 - 12 * nod)}-30-50-44-52"
    d.shape(f"M-69-22C-75-100 75-100 69-22C60-40 50-52 {fringe}C-58-46-64-38-69-22z", "ink", "hair")
    d.add(f'<g transform="translate({n(14 * turn)} {n(-12 * nod)})">')
    for side, name in zip((-1, 1), ("Right", "Left")):
        eye(d, side, get("eyeBlink" + name, 0), get("look", (0, 0)))
        brow(d, side, get("browUp", 0), get("browDown", 0))
    bridge = f"M{n(2 + 9 * turn)} -2C{n(4 + 13 * turn)} 12 {n(9 + 10 * turn)} 20 {n(8 + 9 * turn)} 25"
    d.shape(f"{bridge}Q{n(7 * turn)} 33 {n(-8 + 5 * turn)} 26", "ink")
    mouth(d, get("mouthSmile", 0), get("jawOpen", 0), get("mouthPucker", 0))
    d.add("</g></g>")


def eye(d, side, blink, look):
    """Draws an eye of a head at the origin."""
    x, y, half = EYES[(side + 1) // 2], -8, 15
    if blink > 0.9:
        d.shape(f"M{x - half} {y}Q{x} {y + 11} {x + half} {y}", "ink")
        return
    name = f"{d.name}-{len(d.parts)}"
    upper, lower = 17 * (1 - blink), 13
    if look[1] < 0:
        upper *= 0.7
    shape = f"M{x - half} {y}Q{x} {n(y - upper)} {x + half} {y}Q{x} {y + lower} {x - half} {y}z"
    d.add(f'<clipPath id="{name}"><path d="{shape}"/></clipPath>')
    d.shape(shape, None, "white")
    pupil = f'cx="{n(x + 8 * look[0])}" cy="{n(y - 4 * look[1])}" r="6.5"'
    d.add(f'<circle class="f-dark" {pupil} clip-path="url(#{name})"/>')
    d.shape(shape, "ink", width=2.5)


def brow(d, side, up, down):
    """Draws an eyebrow of a head at the origin, which goes up, or down and inwards."""
    inner, outer = side * (14 - 4 * down), side * 46
    y = -32 - 11 * up
    arch = n(y - 6 - 3 * up + 5 * down)
    d.shape(f"M{n(inner)} {n(y + 4 + 11 * down)}Q{side * 30} {arch} {outer} {n(y + 5)}", "hair", width=7)


def mouth(d, smile, jaw, pucker):
    """Draws the mouth of a head at the origin."""
    if pucker > 0.5:
        d.shape("M-11 55C-9 46-3 45 0 48C3 45 9 46 11 55C9 66-9 66-11 55z", "ink", "lip", width=2.5)
        d.shape("M-5 55h10", "dark", width=2.5)
        return
    half, corner = 25 + 11 * smile - 2 * jaw, 52 - 9 * smile
    if jaw > 0.1:
        low = n(54 + 44 * jaw)
        upper_lip = f"M{n(-half)} 52C{n(-half / 2)} 44 {n(half / 2)} 44 {n(half)} 52"
        d.shape(f"{upper_lip}C{n(half)} {low} {n(-half)} {low} {n(-half)} 52z", "lip", "dark", width=4)
        return
    d.shape(f"M{n(-half)} {n(corner)}Q0 {n(54 + 15 * smile)} {n(half)} {n(corner)}", "lip", width=5)


def profile(d, x, y, size=1.0, dark=False):
    """Draws a head from its right side, which looks to the left of the drawing. Its eye is at (x, y)."""
    d.add(f'<g transform="translate({n(x)} {n(y)}) scale({size:g}) translate(40 14)">')
    d.shape(
        "M44 96C36 74 38 58 46 44C66 30 72 0 64-30C52-72-8-86-38-60C-50-48-52-38-50-27C-50-20-58-8-66 3C-69 8-64 11-56 11C-54"
        " 14-55 17-57 20C-62 23-60 27-55 28C-59 31-59 35-54 37C-54 42-56 48-52 54C-44 63-24 58-14 52C-12 66-14 82-20 96z",
        "ink", "shade" if dark else "skin",
    )
    d.shape(
        "M46 44C66 30 72 0 64-30C52-76-10-88-40-58C-28-44-14-40-2-36C-6-20 2-14 10-18C22-22 26-8 18 4C24 22 34 34 46 44z",
        "ink", "hair",
    )
    d.shape("M8 4C4-10 20-16 22-2C22 8 14 10 12 20", "ink", width=2.5)
    d.shape("M-50-16Q-42-24-34-16Q-42-8-50-16", "ink", "white", width=2.5)
    d.dot(-45, -15.5, 4, "dark")
    d.shape("M-53-32Q-44-40-32-35", "hair", width=6)
    d.add("</g>")
