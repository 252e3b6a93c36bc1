"""Decodes what receivers of other programs get, with their own libraries.

Reads datagrams from standard input, each as its kind and its bytes in hexadecimal digits on a line, and prints what it
finds in each as JSON on a line. Python 3.9 to 3.13 with the packages of requirements.txt.
"""

import json
import sys

from pylivelinkface import pylivelinkface
from pythonosc.osc_bundle import OscBundle


def osc(datagram):
    """Returns the messages of a bundle as lists of the address and the arguments."""
    bundle = OscBundle(datagram)
    return [[message.address, *message.params] for message in bundle]


def live_link(datagram):
    """Returns the subject and the 61 values by their names; no values without a face."""
    has_face, face = pylivelinkface.PyLiveLinkFace.decode(datagram)
    if not has_face:
        return None
    values = {shape.name: face.get_blendshape(shape) for shape in pylivelinkface.FaceBlendShape}
    return {"subject": face.name, "fps": face.fps, "values": values}


def main():
    """Decodes every line."""
    decoders = {"osc": osc, "live-link": live_link}
    for line in sys.stdin:
        kind, digits = line.split()
        print(json.dumps(decoders[kind](bytes.fromhex(digits))))


main()
