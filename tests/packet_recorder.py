#!/usr/bin/env python3
"""Records facewire packets from UDP, with the decoder of packet/python, which shares no code with the sender.

It listens for a while and writes one CSV row per valid packet; its last line on standard error counts packets, losses
and refusals. Exit status 1: not one valid packet came.
"""

import argparse
import contextlib
import csv
import socket
import sys
import time

from facewire_packet import NAMES, decode

HEADER = ["received_s", "state", "reason", "sequence", "age_ms", "capture_us", "qx", "qy", "qz", "qw",
          "x_mm", "y_mm", "z_mm", *NAMES]


def listen(port, seconds, host=""):
    """Yields (receive time, datagram) until `seconds` have passed."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as server:
        server.bind((host, port))
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            server.settimeout(left)
            with contextlib.suppress(TimeoutError):
                yield time.monotonic(), server.recv(65536)


def row(received_s, packet):
    """The packet as cells of the CSV, under HEADER."""
    cells = [f"{received_s:.6f}"]
    cells += [packet[key] for key in ("state", "reason", "sequence", "age_ms", "capture_us")]
    cells += [f"{value:.6f}" for value in packet["rotation"]]
    cells += packet["position_mm"]
    cells += [f"{value:.6f}" for value in packet["coefficients"]]
    return cells


def record(datagrams, out):
    """Writes valid packets as CSV; returns counts of packets, losses (gaps in the sequence) and refusals."""
    writer = csv.writer(out)
    writer.writerow(HEADER)
    out.flush()
    counts = {"packets": 0, "lost": 0, "refused": 0}
    last = None
    for received_s, data in datagrams:
        try:
            packet = decode(data)
        except ValueError as error:
            counts["refused"] += 1
            print(f"refused: {error}", file=sys.stderr)
            continue
        if last is not None:
            counts["lost"] += (packet["sequence"] - last - 1) % 65536
        last = packet["sequence"]
        counts["packets"] += 1
        writer.writerow(row(received_s, packet))
        out.flush()
    return counts


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=5252)
    parser.add_argument("--host", default="", help="address to listen on (default: all of IPv4)")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--csv", default="-", help="file to write, - is standard output")
    args = parser.parse_args()
    target = contextlib.nullcontext(sys.stdout) if args.csv == "-" else open(args.csv, "w", newline="")
    with target as out:
        counts = record(listen(args.port, args.seconds, args.host), out)
    print(" ".join(f"{name} {count}" for name, count in counts.items()), file=sys.stderr)
    return 0 if counts["packets"] else 1


if __name__ == "__main__":
    sys.exit(main())
