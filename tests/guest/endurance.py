#!/usr/bin/env python3
"""endurance.py WORK ROUNDS: pulls the camera and the serial port out of a running service and plugs them in again.

In each round both go and come back once: one after the other, in every fourth round at the same time. In every fifth
another program keeps the old nodes open, so that the devices come back under other numbers. Judged are the time until
the service has them again, what the packets say meanwhile, and that neither descriptors nor memory grow.
Exit status 1: something is not as it should be.
"""

import os
import subprocess
import sys
import time
from collections import namedtuple

from receivers import Datagrams, SerialEnd, Service, await_that, monotonic

# As in the settings, seconds: a pose is live for so long.
LIVE_S = 2.0
# From a device's link in /dev to the camera's first frame, or the board's first packet. To this comes the time that
# another program takes in this guest for the camera's first frame, for so slow is emulation on this machine today.
BACK_S = 1.5
# What emulation may add between two packets.
SLACK_S = 0.25
# What a service may grow by once it has seen every kind of round, KiB.
GROWTH_KB = 512
SETTLED_ROUND = 8
FPS = "4"


class Device:
    """What can be pulled out. `link` is the path that stays."""

    def __init__(self):
        self.kept, self.node = None, None

    def is_there(self):
        """Whether udev has made the link."""
        return os.path.exists(self.link)

    def pull(self, is_kept):
        """Pulls it out; its node may be kept by another program until it is released. Returns when it was gone."""
        self.node = os.path.realpath(self.link)
        self.release()
        if is_kept:
            self.kept = os.open(self.node, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.unplug()
        await_that(f"{self.link} goes", 10, lambda: not self.is_there())
        return time.monotonic()

    def release(self):
        """Lets go of an old node."""
        if self.kept is not None:
            os.close(self.kept)
        self.kept = None

    def appeared(self):
        """Waits for the link; since when it is there. One kept under its old number came under another."""
        await_that(f"{self.link} comes", 20, self.is_there)
        if self.kept is not None and os.path.realpath(self.link) == self.node:
            sys.exit(f"{self.node} was kept open, and is there again under the same number")
        return monotonic(os.lstat(self.link).st_ctime)


class Camera(Device):
    """The USB webcam."""

    link = "/dev/v4l/by-id/usb-Test_bench_UVC_Camera_0001-video-index0"

    def __init__(self, film):
        super().__init__()
        self.film = film

    def plug(self):
        """Begins to plug it in."""
        subprocess.Popen(["uvc-camera", "plug", self.film, FPS])

    def unplug(self):
        """Pulls it out."""
        subprocess.run(["uvc-camera", "unplug"], check=True)


class Serial(Device):
    """The USB serial port."""

    link = "/dev/serial/by-id/usb-Arduino_0043_1234-if00"
    other_end = "/dev/ttyGS0"

    def plug(self):
        """Plugs it in; the first time it is made."""
        if os.path.exists(self.other_end):
            self.bind(os.listdir("/sys/class/udc")[0])
        else:
            subprocess.run(["usb-acm", "plug"], check=True)

    def unplug(self):
        """Pulls it out."""
        self.bind("")

    @staticmethod
    def bind(controller):
        """Gives the board this USB controller, or none."""
        with open("/sys/kernel/config/usb_gadget/acm/UDC", "w") as file:
            file.write(controller + "\n")


# When the camera was gone, when the service saw it, and when it had the camera again.
Absence = namedtuple("Absence", "gone lost opened")


def is_live(packet):
    """Whether the face is followed."""
    return packet["state"] == "live"


def is_blind(packet):
    """Whether it is neutral for lack of a camera."""
    return (packet["state"], packet["reason"]) == ("neutral", "no camera")


class Bench:
    """Service, devices and receivers, and what was measured in each round."""

    def __init__(self, work):
        self.camera, self.serial = Camera(f"{work}/demo.avi"), Serial()
        self.datagrams, self.board = Datagrams(), SerialEnd(Serial.other_end)
        self.service = None
        self.absences, self.camera_back_s, self.live_s, self.serial_back_s = [], [], [], []
        self.bare_s, self.descriptors, self.blind_kb = [], [], []

    def start(self, work):
        """Plugs both in and waits until the face is live at both receivers."""
        self.camera.plug()
        self.serial.plug()
        self.camera.appeared()
        self.serial.appeared()
        self.time_bare_opening()
        begun = time.monotonic()
        self.service = Service(work)
        self.await_live(begun)
        await_that("packets by the serial port", 20, lambda: self.board.first_since(begun))

    def time_bare_opening(self):
        """Times a program that opens the camera, takes one frame and ends."""
        for _ in range(3):
            begun = time.monotonic()
            command = ["v4l2-ctl", "--device", Camera.link, "--stream-mmap", "--stream-count=1"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.bare_s.append(time.monotonic() - begun)

    def await_live(self, since):
        """Waits for a live packet after `since`; its time."""
        return await_that("the face is live", 20, lambda: self.datagrams.first_since(since, is_live))

    def pull_camera(self, is_kept):
        """Pulls the camera out and waits for the neutral face."""
        gone = self.camera.pull(is_kept)
        await_that("neutral, no camera", 10, lambda: self.datagrams.first_since(gone, is_blind))
        return gone

    def await_camera(self, gone):
        """Waits until the camera that was `gone` is used again."""
        there = self.camera.appeared()
        opened = await_that("the camera opens", 20, lambda: self.service.logged_since(gone, "camera opened"))
        self.camera_back_s.append(opened - there)
        self.live_s.append(self.await_live(opened) - there)
        self.absences.append(Absence(gone, self.service.logged_last("camera lost"), opened))

    def await_serial(self, gone):
        """Waits until packets come by the serial port that was `gone`."""
        there = self.serial.appeared()
        back = await_that("a packet by the serial port", 20, lambda: self.board.first_since(gone))
        self.serial_back_s.append(back - there)

    def round(self, number):
        """Both go and come back."""
        at_once, is_kept = number % 4 == 0, number % 5 == 2
        serial_gone = self.serial.pull(is_kept) if at_once else None
        camera_gone = self.pull_camera(is_kept)
        self.blind_kb.append(self.service.resident_kb())
        # So that the devices come back at different moments between two attempts to open them.
        time.sleep(number % 5 * 0.2)
        self.camera.plug()
        if at_once:
            self.serial.plug()
        self.await_camera(camera_gone)
        if not at_once:
            serial_gone = self.serial.pull(is_kept)
            time.sleep(number % 7 * 0.1)
            self.serial.plug()
        self.await_serial(serial_gone)
        self.camera.release()
        self.serial.release()
        self.descriptors.append(self.service.descriptors())


def median(values):
    """The middle one, of two the later: the guest has no module of statistics."""
    return sorted(values)[len(values) // 2]


def complaints_about_times(name, back_s, limit_s):
    """Of the times of all rounds."""
    print(f"{name} back after {median(back_s):.2f} s, at most {max(back_s):.2f} s (limit {limit_s:.2f} s)")
    if max(back_s) > limit_s:
        yield f"{name}: back after {', '.join(f'{time_s:.2f}' for time_s in back_s)} s"


def complaints_about_order(packets, longest_s):
    """Of packets that are missing or late; the loopback interface loses none."""
    gaps = [later - earlier for (earlier, _), (later, _) in zip(packets, packets[1:])]
    numbers = [packet["sequence"] for _, packet in packets]
    lost = sum((later - earlier - 1) % 65536 for earlier, later in zip(numbers, numbers[1:]))
    print(f"{len(packets)} packets by UDP, {lost} missing, at most {max(gaps):.2f} s apart")
    if lost:
        yield f"{lost} packets are missing in the sequence"
    if max(gaps) > longest_s:
        yield f"no packet for {max(gaps):.2f} s"


def changes(states):
    """The states without repetitions."""
    return [state for state, before in zip(states, [None, *states]) if state != before]


def slowest_s(packets):
    """The longest time from a frame's capture to its packet: so long the service may be at work before it looks up."""
    firsts = {packet["capture_us"]: packet["age_ms"] / 1000 for _, packet in reversed(packets) if is_live(packet)}
    return max(firsts.values())


def complaints_about_absence(packets, absence, slowest):
    """Of the packets while there was no camera: hold, decay, neutral, with the reason as soon as the loss was seen."""
    before = [(at, packet) for at, packet in packets if at < absence.opened]
    lives = [number for number, (_, packet) in enumerate(before) if is_live(packet)]
    at, pose = before[lives[-1]]
    if at - pose["age_ms"] / 1000 > absence.gone or pose["age_ms"] / 1000 > LIVE_S:
        yield f"live {at - absence.gone:.2f} s after the camera was gone, by a pose {pose['age_ms']} ms old"
    order = changes([packet["state"] for _, packet in before[lives[-1] + 1:]])
    if order != ["hold", "decay", "neutral"]:
        yield f"without a camera: {order}"
    if absence.lost > absence.gone + slowest + SLACK_S:
        yield f"the loss was seen {absence.lost - absence.gone:.2f} s after the camera was gone"
    # The sender may be about to send when the loss is logged.
    reasons = {packet["reason"] for at, packet in before[lives[-1] + 1:] if at > absence.lost + SLACK_S}
    if reasons != {"no camera"}:
        yield f"without a camera the reasons were {sorted(reasons)}"


def complaints_about_sizes(descriptors, blind_kb):
    """Of descriptors with everything plugged in, and of memory without a camera, in each round."""
    growth_kb = max(blind_kb[SETTLED_ROUND - 1:]) - blind_kb[SETTLED_ROUND - 1]
    print(f"descriptors {sorted(set(descriptors))}, memory without a camera {blind_kb[0]} to {blind_kb[-1]} KiB, "
          f"{growth_kb} KiB of it since round {SETTLED_ROUND}")
    if len(set(descriptors)) > 1:
        yield f"descriptors in each round: {descriptors}"
    if growth_kb > GROWTH_KB:
        yield f"memory in each round: {blind_kb}"


def complaints_about_end(bench, status, rounds):
    """Of how the service ended, and what it said of each round."""
    last = [(packet["state"], packet["reason"]) for _, packet in bench.datagrams.packets[-3:]]
    if status or bench.service.count("panic"):
        yield f"exit status {status}"
    if last != [("neutral", "stopping")] * 3:
        yield f"its last packets were {last}"
    for text in ("camera opened", "link opened"):
        if bench.service.count(text) != rounds + 1:
            yield f"{bench.service.count(text)} times '{text}'"
    for name, end in (("UDP", bench.datagrams), ("serial port", bench.board)):
        if end.refused:
            yield f"{len(end.refused)} packets refused by {name}: {end.refused[0][1]}"


def complaints(bench, status, rounds):
    """Of everything."""
    packets = bench.datagrams.packets
    limit_s = BACK_S + max(bench.bare_s)
    yield from complaints_about_times("camera", bench.camera_back_s, limit_s)
    yield from complaints_about_times("serial port", bench.serial_back_s, BACK_S)
    print(f"live again after {median(bench.live_s):.2f} s, at most {max(bench.live_s):.2f} s")
    yield from complaints_about_order(packets, LIVE_S + SLACK_S)
    slowest = slowest_s(packets)
    print(f"from capture to packet at most {slowest:.2f} s")
    for absence in bench.absences:
        yield from complaints_about_absence(packets, absence, slowest)
    yield from complaints_about_sizes(bench.descriptors, bench.blind_kb)
    yield from complaints_about_end(bench, status, rounds)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    work, rounds = sys.argv[1], int(sys.argv[2])
    bench = Bench(work)
    bench.start(work)
    for number in range(1, rounds + 1):
        bench.round(number)
    status = bench.service.stop()
    bench.time_bare_opening()
    if found := list(complaints(bench, status, rounds)):
        sys.exit("\n".join(found[:20]))


if __name__ == "__main__":
    main()
