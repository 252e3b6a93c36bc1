"""Checks that the service's picture has the coloured bars of the kernel's test camera vivid.

colours.py FORMAT

FORMAT is yuyv or nv12. The service must allow pictures at its control socket. The guest's Python has no module for JSON.
"""

import re
import socket
import sys

CONTROL = "/run/facewire/control"
# Y, Cb and Cr of bars of 75 %, from left to right: white, yellow, cyan, green, magenta, red, blue, black.
BARS = [(180, 128, 128), (162, 44, 142), (131, 156, 44), (112, 72, 58), (84, 184, 198), (65, 100, 212), (35, 212, 114),
        (16, 128, 128)]
MOST_APART = 14


def ask():
    """Returns the head of the next picture, and its bytes."""
    with socket.socket(socket.AF_UNIX) as connection, connection.makefile("rb") as answer:
        connection.connect(CONTROL)
        connection.sendall(b'{"do":"picture"}\n')
        line = answer.readline().decode()
        head = {key: int(value) for key, value in re.findall(r'"(width|height|bytes)":(\d+)', line)}
        if len(head) != 3:
            sys.exit(f"no picture: {line}")
        head["format"] = re.search(r'"format":"(\w+)"', line)[1]
        return head, answer.read(head["bytes"])


def colour(head, rows, x, y):
    """The luma and the chroma of a pixel."""
    width, height = head["width"], head["height"]
    x -= x % 2
    if head["format"] == "yuyv":
        at = 2 * (y * width + x)
        return rows[at], rows[at + 1], rows[at + 3]
    at = width * height + y // 2 * width + x
    return rows[y * width + x], rows[at], rows[at + 1]


def main():
    """Checks the middle of each bar, below what the camera writes into its picture."""
    head, rows = ask()
    if head["format"] != sys.argv[1]:
        sys.exit(f"the picture is {head['format']}")
    width, height = head["width"], head["height"]
    found = [colour(head, rows, (2 * bar + 1) * width // 16, height * 7 // 8) for bar in range(8)]
    if any(abs(one - other) > MOST_APART for samples, bar in zip(found, BARS) for one, other in zip(samples, bar)):
        sys.exit(f"the bars have other colours: {found}")


main()
