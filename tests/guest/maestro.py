"""Plays a Mini Maestro at the other end of a serial line, by the compact protocol: answers the question for errors, and writes
each target that a channel gets as a line `CHANNEL TARGET` into a file, in quarters of a microsecond; 0 ends the pulses."""

import os
import sys

SET_TARGET, SET_SPEED, SET_ACCELERATION, SET_MULTIPLE, GET_ERRORS, POLOLU = 0x84, 0x87, 0x89, 0x9F, 0xA1, 0xAA


def main(device, log):
    """Answers until the line ends."""
    line = os.open(device, os.O_RDWR | os.O_NOCTTY)
    byte = lambda: os.read(line, 1)[0]
    with open(log, "a", buffering=1) as targets:
        while True:
            command = byte()
            if command == POLOLU:
                byte()
                command = byte() | 0x80
            if command == SET_TARGET:
                channel, low, high = byte(), byte(), byte()
                targets.write(f"{channel} {low | high << 7}\n")
            elif command in (SET_SPEED, SET_ACCELERATION):
                byte(), byte(), byte()
            elif command == SET_MULTIPLE:
                count, first = byte(), byte()
                for channel in range(first, first + count):
                    targets.write(f"{channel} {byte() | byte() << 7}\n")
            elif command == GET_ERRORS:
                os.write(line, b"\0\0")


main(*sys.argv[1:])
