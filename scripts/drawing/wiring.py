"""How boards and servos are connected."""

from .canvas import LARGE, SMALL, Drawing


def drawings():
    """Returns the drawings of this file."""
    return [pca9685(), maestro(), bus_servos(), uart()]


def pin(d, x, y, number, name, colour="ink"):
    """Draws a pin at the right edge of a Raspberry Pi, with its number in the header."""
    d.badge(x, y, number, colour)
    d.label(x - 26, y + 7, name, colour, "end")


def pad(d, x, y, name, colour="ink", anchor="start"):
    """Draws a pad at the edge of a board, with its name inside the board."""
    d.box(x - 8, y - 8, 16, 16, colour, colour, corner=3)
    away = {"start": 18, "end": -18}[anchor]
    d.label(x + away, y + 7, name, colour, anchor)


def servo(d, x, y):
    """Draws a servo with its horn."""
    d.box(x, y, 96, 48, "ink", "fill", corner=5)
    d.circle(x + 24, y + 24, 15, "ink", "plate")
    d.circle(x + 24, y + 24, 3, "ink", "ink")


def cable(d, start, end, y):
    """Draws the three wires of a servo: signal, plus and ground."""
    for place, colour in enumerate(("amber", "red", "ink")):
        d.line([(start, y - 8 + 8 * place), (end, y - 8 + 8 * place)], colour, 4)


def capacitor(d, x, plus_y, ground_y):
    """Draws a capacitor between two wires, one above the other."""
    middle = (plus_y + ground_y) / 2
    d.line([(x, plus_y), (x, middle - 6)], "red", 4)
    d.line([(x, middle + 6), (x, ground_y)], "ink", 4)
    d.label(x - 24, middle - 8, "+", "red", "end", bold=True)
    d.line([(x - 20, middle - 6), (x + 20, middle - 6)], "ink", 5)
    d.line([(x - 20, middle + 6), (x + 20, middle + 6)], "ink", 5)


def switch(d, x, y):
    """Draws an open switch in a level wire, from x - 22 to x + 22."""
    d.shape(f"M{x - 16} {y}H{x + 16}", "plate", width=14)
    d.shape(f"M{x - 20} {y}L{x + 16} {y - 20}", "red", width=4)
    d.dot(x - 22, y, 6, "red")
    d.dot(x + 22, y, 6, "red")


def supply(d, x, y):
    """Draws the supply of the servos, with plus at y + 34 and minus at y + 104 of its right edge."""
    d.box(x, y, 190, 138)
    d.lines_of_text(x + 16, y + 38, ["Servo supply", "5 to 6 V"], bold=True)
    d.label(x + 16, y + 112, "not the Pi's", "grey")
    d.badge(x + 190, y + 34, "+", "red")
    d.badge(x + 190, y + 104, "−", "ink")


def connected_supply(d, y, board_y, pads):
    """Draws the supply at the left, its switch and its capacitor, and its wires to two pads above, given by place and name."""
    (plus_x, _), (minus_x, _) = pads
    plus_y, minus_y = y + 34, y + 104
    d.wire([(214, plus_y), (plus_x, plus_y), (plus_x, board_y + 16)], "red", 5)
    d.wire([(214, minus_y), (minus_x, minus_y), (minus_x, board_y + 16)], "ink", 5)
    capacitor(d, plus_x - 48, plus_y, minus_y)
    switch(d, plus_x - 112, plus_y)
    supply(d, 24, y)
    for (x, name), colour in zip(pads, ("red", "ink")):
        d.box(x - 10, board_y, 20, 20, colour, colour, corner=3)
        d.label(x, board_y - 10, name, colour, "middle", bold=True)
    d.label(plus_x - 112, y, "switch", "ink", "middle", SMALL)
    d.label(plus_x - 48, y + 132, "1000 µF or more", "ink", "middle", SMALL)


def legend(d, y, entries):
    """Explains the colours of wires in one row."""
    x = 30
    for colour, text in entries:
        d.shape(f"M{x} {y}h30", colour, width=5)
        d.label(x + 40, y + 7, text, size=SMALL)
        x += 175


def pca9685():
    """The four wires from a Raspberry Pi to a PCA9685, and the supply of its servos."""
    d = Drawing(
        "wiring-pca9685", 720, "A PCA9685 at a Raspberry Pi",
        "Four wires lead from the header of the Raspberry Pi to the PCA9685: pin 1, 3.3 volts, to VCC; pin 3 to SDA; pin 5 to"
        " SCL; pin 6 to GND. The servos have a supply of their own, whose plus goes through a switch to V+ and whose minus to"
        " GND, with a capacitor of 1000 microfarads across it. The 5 volts of the Raspberry Pi, pin 2, must not be connected"
        " to V+.",
    )
    d.box(24, 24, 210, 420)
    d.label(40, 58, "Raspberry Pi", bold=True, size=LARGE)
    d.box(408, 24, 160, 390)
    d.label(424, 58, "PCA9685", bold=True, size=LARGE)
    for y, number, name, other, colour in (
        (104, "1", "3.3 V", "VCC", "green"), (154, "3", "SDA", "SDA", "blue"),
        (204, "5", "SCL", "SCL", "blue"), (254, "6", "GND", "GND", "ink"),
    ):
        d.wire([(250, y), (400, y)], colour)
        pin(d, 234, y, number, name, colour)
        pad(d, 408, y, other, colour)
    d.wire([(250, 314), (348, 314)], "red", dashed=True)
    pin(d, 234, 314, "2", "5 V", "red")
    d.cross(350, 314)
    d.lines_of_text(252, 354, ["never to V+", "or servos"], "red")
    pad(d, 408, 308, "OE", "grey")
    d.label(426, 338, "leave open", "grey", size=SMALL)
    # The first ten pins, as they lie beside each other.
    d.label(40, 376, "pins 1 to 10", "grey", size=SMALL)
    used = {1: "green", 3: "blue", 5: "blue", 6: "ink"}
    for place in range(1, 11):
        x, y = 54 + (place - 1) // 2 * 28, (422 if place % 2 else 396)
        colour = used.get(place, "red" if place == 2 else None)
        d.circle(x, y, 9, colour or "grey", colour or "plate", width=2)
    # Servos.
    for y, name in ((104, "0"), (174, "1"), (254, "15")):
        cable(d, 568, 606, y)
        d.label(556, y + 7, name, "ink", "end", bold=True)
        servo(d, 606, y - 24)
    d.label(545, 222, "…", "ink", "middle")
    d.lines_of_text(590, 312, ["up to", "16 servos"], "grey", size=SMALL)
    connected_supply(d, 510, 404, ((448, "V+"), (528, "GND")))
    d.lines_of_text(548, 530, ["All grounds", "are joined."], bold=True)
    legend(d, 690, (("red", "servo supply"), ("ink", "ground"), ("blue", "data"), ("green", "3.3 V")))
    return d


def maestro():
    """A Maestro by USB, with a supply for its servos."""
    d = Drawing(
        "wiring-maestro", 640, "A Maestro on USB",
        "A USB cable leads from the board that runs facewire to the Maestro. The servos' supply goes through a switch to the"
        " servo power pins of the Maestro. The jumper between VSRV and VIN is removed. The servos are plugged into channels,"
        " which count from 0.",
    )
    d.box(24, 60, 190, 110)
    d.lines_of_text(40, 100, ["Board with", "facewire"], bold=True, size=LARGE)
    d.wire([(218, 115), (330, 115)], "blue", 6)
    d.label(272, 98, "USB", "blue", "middle")
    d.box(330, 24, 210, 370)
    d.label(346, 58, "Maestro", bold=True, size=LARGE)
    d.box(322, 99, 18, 32, "blue", "blue", corner=3)
    # The jumper.
    for place, name in enumerate(("VSRV", "VIN")):
        d.circle(358, 208 + 34 * place, 8, "ink", "plate")
        d.label(376, 215 + 34 * place, name, size=SMALL)
    d.box(256, 196, 30, 58, "blue", "fill", corner=5)
    d.line([(342, 225), (298, 225)], "blue", 3, arrow=True)
    d.lines_of_text(24, 214, ["12 channels or", "more: remove", "this jumper"])
    for y, name in ((90, "0"), (160, "1"), (230, "2"), (330, "23")):
        cable(d, 540, 592, y)
        d.label(526, y + 7, name, "ink", "end", bold=True)
        servo(d, 592, y - 24)
    d.label(515, 288, "…", "ink", "middle")
    d.label(640, 392, "brown or black", "ink", "middle", SMALL)
    d.label(640, 416, "is ground", "ink", "middle", SMALL)
    connected_supply(d, 440, 384, ((390, "+"), (470, "−")))
    d.lines_of_text(500, 480, ["The Maestro joins", "the supply's ground", "with that of USB."], size=SMALL)
    legend(d, 612, (("red", "servo supply"), ("ink", "ground"), ("amber", "pulses"), ("blue", "USB")))
    return d


def bus_servos():
    """A line of bus servos behind a USB adapter."""
    d = Drawing(
        "wiring-bus-servos", 650, "Bus servos on one line",
        "A USB cable leads from the board to the adapter. From the adapter, one cable goes from servo to servo, with data and"
        " ground. Its third wire, plus, comes from the servos' supply, whose minus is joined with the ground. On a long line"
        " the supply is connected at several places. Each servo has a number of its own, its ID. The last socket stays empty.",
    )
    d.box(24, 32, 200, 100)
    d.lines_of_text(40, 74, ["Board with", "facewire"], bold=True, size=LARGE)
    d.wire([(226, 82), (338, 82)], "blue", 6)
    d.label(282, 66, "USB", "blue", "middle")
    d.box(340, 32, 200, 100)
    d.label(356, 74, "Adapter", bold=True, size=LARGE)
    d.label(356, 106, "gives no power", "grey")
    d.lines_of_text(560, 168, ["one data wire,", "both ways"], "amber")
    # Data and ground from the adapter, plus from the supply.
    d.wire([(500, 136), (500, 168), (44, 168), (44, 276), (76, 276)], "ink")
    d.wire([(520, 136), (520, 182), (60, 182), (60, 262), (76, 262)], "amber")
    d.wire([(104, 434), (104, 400), (60, 400), (60, 290), (76, 290)], "red")
    d.wire([(44, 434), (44, 282)], "ink")
    d.dot(44, 276, 7)
    d.label(280, 218, "one cable from servo to servo", "ink", "middle")
    servos = ("1", "jaw"), ("2", "left lid"), ("3", "right lid"), ("4", "neck")
    for place, (number, name) in enumerate(servos):
        x = 78 + 156 * place
        if place:
            for row, colour in enumerate(("amber", "ink", "red")):
                d.line([(x - 38, 262 + 14 * row), (x - 2, 262 + 14 * row)], colour, 4)
        d.box(x, 236, 116, 80, corner=6)
        d.circle(x + 29, 276, 18, "ink", "plate")
        d.dot(x + 29, 276, 4)
        d.label(x + 54, 284, "ID " + number, bold=True)
        d.label(x + 58, 346, name, "grey", "middle")
    d.box(664, 256, 22, 40, "ink", "plate", corner=4)
    d.line([(674, 306), (674, 366)], "grey", 2)
    d.lines_of_text(696, 386, ["last socket:", "empty"], "grey", "end")
    # The supply, at the beginning and in the middle of the line.
    d.box(24, 436, 210, 130)
    d.badge(104, 436, "+", "red")
    d.badge(44, 436, "−", "ink")
    d.lines_of_text(40, 484, ["Servo supply"], bold=True)
    d.lines_of_text(40, 514, ["voltage as in", "their data sheet"], "grey")
    d.wire([(236, 470), (362, 470), (362, 296)], "red", dashed=True)
    d.wire([(236, 520), (378, 520), (378, 282)], "ink", dashed=True)
    d.dot(362, 290, 7, "red")
    d.dot(378, 276, 7)
    d.lines_of_text(400, 484, ["on a long line:", "here, too"])
    legend(d, 620, (("amber", "data"), ("red", "plus"), ("ink", "ground"), ("blue", "USB")))
    return d


def uart():
    """A Raspberry Pi's serial pins and a board of 5 V."""
    d = Drawing(
        "wiring-uart", 860, "A Raspberry Pi's serial pins and a board of 5 volts",
        "Above, all that facewire needs: TXD of the Raspberry Pi, pin 8, leads to RX of the board, and GND, pin 6, to its"
        " GND. TX of the board has 5 volts and must not be connected to RXD, pin 10. Below, with a level shifter both ways:"
        " TXD leads to RX and TX to RXD, each through the level shifter, which gets 3.3 volts on one side and 5 volts on the"
        " other. A divider of 1 and 2 kilohms between TX and ground also brings 5 volts down to 3.3.",
    )
    d.label(24, 50, "All that facewire needs: two wires", bold=True, size=LARGE)
    d.box(24, 72, 190, 210)
    d.label(40, 106, "Raspberry Pi", bold=True)
    d.box(506, 72, 190, 210)
    d.label(522, 106, "5 V board", bold=True)
    d.wire([(230, 144), (493, 144)], "blue", arrow=True)
    d.wire([(230, 194), (498, 194)], "ink")
    d.wire([(498, 244), (238, 244)], "red", dashed=True)
    for y, number, name, other, colour in (
        (144, "8", "TXD 3.3 V", "RX", "blue"), (194, "6", "GND", "GND", "ink"), (244, "10", "RXD", "TX 5 V", "red"),
    ):
        pin(d, 214, y, number, name, colour)
        pad(d, 506, y, other, colour)
    d.cross(360, 244)
    d.label(360, 276, "5 V harms the pin", "red", "middle")
    d.label(24, 336, "Both ways: with a level shifter", bold=True, size=LARGE)
    d.box(24, 358, 190, 256)
    d.label(40, 392, "Raspberry Pi", bold=True)
    d.box(506, 358, 190, 256)
    d.label(522, 392, "5 V board", bold=True)
    d.box(296, 358, 128, 256, "blue")
    d.label(360, 392, "shifter", "blue", "middle", bold=True)
    rows = (430, "1", "3.3 V", "LV", "HV", "5 V", "green"), (480, "8", "TXD", "A1", "B1", "RX", "blue"), \
        (530, "10", "RXD", "A2", "B2", "TX", "amber"), (580, "6", "GND", "", "", "GND", "ink")
    for y, number, name, low, high, other, colour in rows:
        far = "red" if colour == "green" else colour
        near_wire, far_wire = [(230, y), (290, y)], [(430, y), (500, y)]
        if colour == "amber":
            near_wire, far_wire = [(290, y), (238, y)], [(498, y), (440, y)]
        elif colour == "blue":
            near_wire, far_wire = [(230, y), (283, y)], [(430, y), (493, y)]
        is_signal = colour in ("blue", "amber")
        d.wire(near_wire, colour, arrow=is_signal)
        d.wire(far_wire, far, arrow=is_signal)
        pin(d, 214, y, number, name, colour)
        pad(d, 506, y, other, far)
        pad(d, 296, y, low, colour)
        pad(d, 424, y, high, far, "end")
    d.label(360, 587, "GND", "ink", "middle")
    d.label(24, 668, "Or a divider in the wire back:", bold=True, size=LARGE)
    d.wire([(110, 716), (420, 716)], "amber")
    d.wire([(530, 716), (600, 716)], "amber")
    d.wire([(360, 792), (360, 816), (600, 816)], "ink")
    d.line([(360, 716), (360, 740)], "amber", 4)
    d.box(420, 700, 110, 32, "ink", "fill", 4)
    d.label(475, 723, "1 kΩ", "ink", "middle")
    d.box(344, 740, 32, 52, "ink", "fill", 4)
    d.label(390, 773, "2 kΩ", "ink")
    d.dot(360, 716, 7, "amber")
    d.label(98, 723, "RXD", "ink", "end")
    d.label(235, 752, "3.3 V", "amber", "middle")
    d.label(612, 723, "TX 5 V")
    d.label(612, 823, "GND")
    return d
