"""From the camera to what moves."""

from .canvas import LARGE, Drawing


def flow():
    """The way from the camera through facewire to the receivers."""
    d = Drawing(
        "flow", 620, "From the camera to what moves",
        "A webcam gives pictures to facewire, which runs on a small Linux board such as a Raspberry Pi. Inside, 478 landmarks"
        " of the face become 52 coefficients and the rotation and position of the head; a failsafe leads the face to neutral"
        " when the camera fails or nobody is in the picture. The receivers are servos, Arduino and ESP32, DMX, Unreal, VRChat"
        " and VMC, ROS 2 and MQTT, and programs in Python, C or Rust.",
    )
    d.label(90, 176, "Webcam", "ink", "middle", LARGE, bold=True)
    d.box(40, 202, 100, 76, "ink", "fill", 14)
    d.circle(90, 240, 24, "ink", "plate")
    d.dot(90, 240, 11, "blue")
    d.shape("M90 280v22M58 306h64", "ink", width=6)
    d.line([(146, 240), (186, 240)], "blue", 5, arrow=True)
    d.box(196, 24, 264, 572, "blue", "plate", 16)
    d.label(328, 66, "facewire", "blue", "middle", 26, bold=True)
    d.label(328, 96, "on a Linux board", "grey", "middle")
    steps = (
        (130, "478 landmarks", "of the face"),
        (280, "52 coefficients", "and head pose"),
        (430, "failsafe", "no face, no camera:"),
    )
    for y, name, detail in steps:
        height = 100 if y < 420 else 130
        d.box(214, y, 228, height)
        d.label(328, y + 44, name, "ink", "middle", LARGE, bold=True)
        d.label(328, y + 76, detail, "ink", "middle")
        if y < 420:
            d.line([(328, y + 104), (328, y + 140)], "blue", 5, arrow=True)
    d.label(328, 532, "back to neutral", "ink", "middle")
    receivers = ("servos", "Arduino, ESP32", "DMX", "Unreal", "VRChat, VMC", "ROS 2, MQTT", "Python, C, Rust")
    for place, name in enumerate(receivers):
        y = 52 + 86 * place
        d.box(512, y - 28, 184, 56)
        d.label(604, y + 7, name, "ink", "middle")
        d.line([(464, y), (502, y)], "blue", 4, arrow=True)
    return d
