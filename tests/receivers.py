"""Decodes what receivers of other programs get, with their own libraries.

Reads datagrams from standard input, each as its kind and its bytes in hexadecimal digits on a line, and prints what it
finds in each as JSON on a line. Python 3.9 to 3.13 with the packages of requirements.txt.
"""

import json
import socket
import sys
import time

from pylivelinkface import pylivelinkface
from pythonosc.osc_bundle import OscBundle
from sacn.receiving.receiver_handler import ReceiverHandler
from stupidArtnet import StupidArtnetServer


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


class Sacn:
    """A receiver of E1.31, which follows priorities, numbers and the end of streams over all datagrams."""

    def __init__(self):
        self.handler = ReceiverHandler("", 0, self, socket=self)
        self.told = []

    def on_availability_change(self, universe, changed):
        self.told.append([universe, changed])

    def on_dmx_data_change(self, packet):
        self.told.append([packet.universe, packet.sourceName, packet.priority, list(packet.dmxData)])

    def decode(self, datagram):
        """Returns what the receiver tells: universes that come and go, and values that change."""
        self.told = []
        self.handler.on_data(datagram, time.time())
        return self.told


class ArtNet:
    """A receiver of Art-Net, which follows the numbers of all datagrams to universe 300."""

    def __init__(self):
        self.server, self.values = StupidArtnetServer(port=0), None
        self.server.register_listener(300, callback_function=self.take)
        self.sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def take(self, values):
        self.values = values

    def decode(self, datagram):
        """Returns the values, or nothing if they are not taken."""
        self.values = None
        # Its own thread opens its socket.
        waits_until(lambda: self.server.socket_server and self.server.socket_server.getsockname()[1])
        self.sender.sendto(datagram, ("127.0.0.1", self.server.socket_server.getsockname()[1]))
        waits_until(lambda: self.values is not None)
        return self.values


def waits_until(is_so):
    """Waits for a second at most."""
    end = time.monotonic() + 1
    while not is_so() and time.monotonic() < end:
        time.sleep(0.002)


def main():
    """Decodes every line."""
    decoders = {"osc": osc, "live-link": live_link, "sacn": Sacn().decode, "artnet": ArtNet().decode}
    for line in sys.stdin:
        kind, digits = line.split()
        print(json.dumps(decoders[kind](bytes.fromhex(digits))))


main()
