#!/usr/bin/env python3
"""stalled.py WORK: the board at a USB serial port stops reading while the service sends to it and by UDP.

Judged are what comes by UDP meanwhile, how fresh the packets are once the board reads again, that the port is back after
it was pulled out while it was stuck, and that the service ends in time with a stuck port.
Exit status 1: something is not as it should be.
"""

import sys
import time

from endurance import BACK_S, SLACK_S, Serial, complaints_about_order
from receivers import Datagrams, SerialEnd, Service, await_that

# How often a neutral face is sent, seconds.
PERIOD_S = 0.1
# A packet is fresh if so many newer ones have been sent at most.
FRESH = 2
# Ending, as docs/service.md has it, seconds.
END_S = 2.0


def stall(board, service):
    """Lets the board read nothing until the service drops packets, and some time longer."""
    begun = time.monotonic()
    board.reading.clear()
    await_that("the service sees it", 60, lambda: service.logged_since(begun, "it takes no packets"))
    print(f"stuck after {time.monotonic() - begun:.1f} s")
    time.sleep(3)


def fresh_from(number, board, datagrams):
    """The index of the first packet by the serial port, from this one on, that was fresh when it came, or None."""
    for index, (at, packet) in enumerate(board.packets[number:], number):
        newest = max((sent["sequence"] for sent_at, sent in datagrams.packets if sent_at <= at), default=0)
        if packet["sequence"] + FRESH >= newest:
            return index
    return None


def resume(board, datagrams):
    """Lets the board read again; complaints about what it gets."""
    begun, old = time.monotonic(), len(board.packets)
    board.reading.set()
    fresh = await_that("a fresh packet", 20, lambda: fresh_from(old, board, datagrams))
    waited_s = board.packets[fresh][0] - begun
    print(f"{fresh - old} old packets lay in the line, then a fresh one after {waited_s:.2f} s")
    time.sleep(2)
    numbers = [packet["sequence"] for _, packet in board.packets[fresh:]]
    if waited_s > BACK_S or numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        yield f"fresh after {waited_s:.2f} s, then {numbers}"
    if len(numbers) < 2 / PERIOD_S - 3:
        yield f"{len(numbers)} packets in 2 s"


def replug(board, serial):
    """Pulls the stuck port out and plugs it in again; complaints about its return."""
    gone = serial.pull(is_kept=False)
    board.reading.set()
    serial.plug()
    there = serial.appeared()
    back = await_that("a packet", 20, lambda: board.first_since(gone))
    print(f"pulled out while stuck, back after {back - there:.2f} s")
    if back - there > BACK_S:
        yield f"back after {back - there:.2f} s"


def complaints(work):
    """Of the whole course."""
    serial, datagrams, board = Serial(), Datagrams(), SerialEnd(Serial.other_end)
    serial.plug()
    serial.appeared()
    service = Service(work)
    await_that("packets by the serial port", 20, lambda: board.packets)
    stall(board, service)
    yield from resume(board, datagrams)
    stall(board, service)
    yield from replug(board, serial)
    stall(board, service)
    begun = time.monotonic()
    status = service.stop()
    print(f"ended with status {status} in {time.monotonic() - begun:.2f} s")
    if status or time.monotonic() - begun > END_S:
        yield f"ended with status {status} in {time.monotonic() - begun:.2f} s"
    yield from complaints_about_order(datagrams.packets, PERIOD_S + SLACK_S)
    dropped = int(service.last_line().split(" dropped=")[1].split()[0])
    print(f"{dropped} packets dropped")
    # Of three stalls with three seconds each.
    if dropped < 9 / PERIOD_S - 10:
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
