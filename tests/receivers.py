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

    # A datagram to universe 301 without a number. It tells that the receiver is done with the one before it.
    MARK = b"Art-Net\0" + bytes([0, 0x50, 0, 14, 0, 0, 301 & 255, 301 >> 8, 0, 2, 0, 0])

    def __init__(self):
        self.server, self.values, self.is_done = StupidArtnetServer(port=0), None, False
        self.server.register_listener(300, callback_function=self.take)
        self.server.register_listener(301, callback_function=self.end)
        self.sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def take(self, values):
        self.values = values

    def end(self, _values):
        self.is_done = True

    def decode(self, datagram):
        """Returns the values, or nothing if they are not taken."""
        self.values, self.is_done = None, False
        # Its own thread opens its socket.
        waits_until(lambda: self.server.socket_server and self.server.socket_server.getsockname()[1])
        for sent in [datagram, self.MARK]:
            self.sender.sendto(sent, ("127.0.0.1", self.server.socket_server.getsockname()[1]))
        waits_until(lambda: self.is_done)
        return self.values


def waits_until(is_so):
    """Waits for a minute at most."""
    end = time.monotonic() + 60
    while not is_so():
        if time.monotonic() > end:
            sys.exit("the receiver of Art-Net is not done within a minute")
        time.sleep(0.002)


def main():
    """Decodes every line."""
    decoders = {"osc": osc, "live-link": live_link, "sacn": Sacn().decode, "artnet": ArtNet().decode}
    for line in sys.stdin:
        kind, digits = line.split()
        print(json.dumps(decoders[kind](bytes.fromhex(digits))))


main()
