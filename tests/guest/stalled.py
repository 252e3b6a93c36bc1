#!/usr/bin/env python3
"""stalled.py WORK: the board at a USB serial port stops reading while the service sends to it and by UDP.

Judged are the packets by UDP meanwhile, how fresh the packets are once the board reads again, that the port is back after
it was unplugged while it was stuck, and that the service ends in time with a stuck port.
Exit status 1: something was not as it should be.
"""

import sys
import time

from endurance import BACK_S, PERIOD_S, SLACK_S, Serial, complaints_about_order, first_packet_again
from receivers import Datagrams, Lag, SerialEnd, Service, await_that

# A packet is fresh if at most this many newer packets had been sent when it came.
FRESH = 2
# How many fresh packets show that the line has recovered.
RECOVERED = 20
# How many times the board stops reading, how many packets go by UDP before it reads again, and how many of them may still
# have found room in the line.
STALLS, STALLED, LATE = 3, 30, 5
# How long the service takes to end, as docs/faults.md promises, seconds.
END_S = 2.0


def stall(board, datagrams, service):
    """Lets the board read nothing until the service drops packets, and for some packets more."""
    begun = time.monotonic()
    board.reading.clear()
    await_that("the service sees it", lambda: service.logged_since(begun, "it takes no packets"))
    print(f"stuck after {time.monotonic() - begun:.1f} s")
    sent = len(datagrams.packets)
    await_that("packets by UDP", lambda: len(datagrams.packets) > sent + STALLED)


def fresh_from(number, board, datagrams):
    """Returns the fresh packets by the serial port from this one on, as pairs of time and sequence."""
    found, sent, newest = [], iter(datagrams.packets.copy()), 0
    upcoming = next(sent, None)
    for at, packet in board.packets[number:]:
        while upcoming and upcoming[0] <= at:
            newest, upcoming = upcoming[1]["sequence"], next(sent, None)
        if packet["sequence"] + FRESH >= newest:
            found.append((at, packet["sequence"]))
    return found


def resume(board, datagrams, lag):
    """Lets the board read again; complaints about the packets that it gets."""
    begun, old = time.monotonic(), len(board.packets)
    board.reading.set()
    fresh = await_that("a fresh packet", lambda: fresh_from(old, board, datagrams))
    waited_s = fresh[0][0] - begun
    print(f"a fresh packet after {waited_s:.2f} s")
    await_that("fresh packets", lambda: len(fresh_from(old, board, datagrams)) >= RECOVERED)
    if waited_s > BACK_S + lag.slack_s():
        yield f"fresh after {waited_s:.2f} s"
    numbers = [packet["sequence"] for _, packet in board.packets[old:]]
    if numbers != sorted(numbers):
        yield f"out of order: {numbers}"


def replug(board, serial, service, lag):
    """Unplugs the stuck port and plugs it in again; complaints about its return."""
    gone = serial.pull(is_kept=False)
    board.reading.set()
    serial.plug()
    there = serial.appeared()
    back_s = first_packet_again(service, board, gone) - there
    print(f"unplugged while stuck, back after {back_s:.2f} s")
    if back_s > BACK_S + lag.slack_s():
        yield f"back after {back_s:.2f} s"


def complaints(work):
    """All complaints."""
    serial, datagrams, board, lag = Serial(), Datagrams(), SerialEnd(Serial.other_end), Lag()
    serial.plug()
    serial.appeared()
    service = Service(work)
    await_that("packets by the serial port", lambda: board.packets)
    stall(board, datagrams, service)
    yield from resume(board, datagrams, lag)
    stall(board, datagrams, service)
    yield from replug(board, serial, service, lag)
    stall(board, datagrams, service)
    begun = time.monotonic()
    status = service.stop()
    took_s = time.monotonic() - begun
    print(f"ended with status {status} in {took_s:.2f} s; sleepers were {lag.worst_s:.2f} s late")
    if status or took_s > END_S + lag.slack_s():
        yield f"ended with status {status} in {took_s:.2f} s"
    yield from complaints_about_order(datagrams, PERIOD_S + SLACK_S + lag.slack_s())
    dropped = int(service.last_line().split(" dropped=")[1].split()[0])
    print(f"{dropped} packets dropped")
    if dropped < STALLS * (STALLED - LATE):
        yield f"only {dropped} packets were counted as dropped"
    if datagrams.refused or board.refused:
        yield f"refused: {(datagrams.refused + board.refused)[0][1]}"


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    if found := list(complaints(sys.argv[1])):
        sys.exit("\n".join(found))


if __name__ == "__main__":
    main()
