#!/usr/bin/env python3
"""Receives facewire's packets and prints jaw, left lid and head, 25 times a second. Put your own code into show().

receiver.py                           by UDP, on port 5252
receiver.py --host :: --port 5253     by UDP over IPv6 and IPv4, on another port
receiver.py --serial /dev/ttyUSB0     by a serial line (needs pyserial: apt install python3-serial)
"""

import argparse
import socket
import sys
import time

from facewire_packet import Receiver, cobs_decode, decode


def show(face):
    shape = face["coefficients"]
    values = [shape["jawOpen"], shape["eyeBlinkLeft"], *face["rotation"]]
    print("silent" if face["silent"] else "live", *(f"{value:.3f}" for value in values), flush=True)


def datagrams(host, port):
    """Yields each datagram, and None when none has come for 10 ms."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM) as server:
        if ":" in host:
            server.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        server.bind((host, port))
        server.settimeout(0.01)
        while True:
            try:
                yield server.recv(2048)
            except socket.timeout:
                yield None


def frames(device, baud):
    """Yields what each frame of a serial line contains, and None when no frame has ended for 10 ms."""
    import serial

    while True:
        try:
            with serial.Serial(device, baud, timeout=0.01) as line:
                rest = b""
                while True:
                    *ended, rest = (rest + line.read(max(1, line.in_waiting))).split(b"\0")
                    rest = rest[-256:]  # in case that something else sends, which never ends a frame
                    yield from filter(None, ended)
                    yield None
        except OSError as error:  # unplugged, or not plugged in yet
            print(error, file=sys.stderr)
            for _ in range(100):
                time.sleep(0.01)
                yield None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="0.0.0.0", help="address to listen on (default: all of IPv4)")
    parser.add_argument("--port", type=int, default=5252)
    parser.add_argument("--serial", metavar="DEVICE", help="serial port to read instead")
    parser.add_argument("--baud", type=int, default=115200)
    args = parser.parse_args()
    receiver, shown_s = Receiver(), 0.0
    for data in frames(args.serial, args.baud) if args.serial else datagrams(args.host, args.port):
        now_s = time.monotonic()
        if data is not None:
            try:
                receiver.receive(decode(cobs_decode(data) if args.serial else data), now_s)
            except ValueError as error:
                print("refused:", error, file=sys.stderr)
        if now_s - shown_s >= 0.04:
            show(receiver.show(now_s))
            shown_s = now_s


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
