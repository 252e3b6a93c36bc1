"""Plays the microcontroller board: reads packets from a serial port until one gives a reason. Every frame must be a packet,
but the first, of which only the end may have come.

board.py PORT REASON
"""

import collections
import os
import select
import sys

from facewire_packet import cobs_decode, decode
from receivers import await_that


class Board:
    """The packets that have come so far."""

    def __init__(self, port):
        self.port = os.open(port, os.O_RDWR | os.O_NOCTTY)
        self.rest = None
        self.reasons = collections.Counter()

    def take(self, bytes_):
        """Takes bytes of the line."""
        if self.rest is None:
            _, _, after = bytes_.partition(b"\0")
            self.rest = after
            return
        *frames, self.rest = (self.rest + bytes_).split(b"\0")
        self.reasons.update(decode(cobs_decode(frame))["reason"] for frame in frames if frame)

    def has(self, reason):
        """Reads what has come; returns whether a packet has given the reason."""
        if select.select([self.port], [], [], 0.2)[0]:
            self.take(os.read(self.port, 4096))
        return self.reasons[reason] > 0


def main():
    """Reads the port."""
    board, reason = Board(sys.argv[1]), sys.argv[2]
    await_that(f"a packet with the reason {reason}", lambda: board.has(reason))
    print("packets by serial line:", ", ".join(f"{count} with {name}" for name, count in board.reasons.items()))


if __name__ == "__main__":
    main()
