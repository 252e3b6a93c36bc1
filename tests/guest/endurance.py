#!/usr/bin/env python3
"""endurance.py WORK FILM ROUNDS: unplugs the camera and the serial port of a running service and plugs them in again.

In each round both are unplugged and come back once: one after the other, in every fourth round at the same time. In every
fifth round another program keeps the old nodes open, so that the devices come back under other numbers. Judged are the
time until the service has them again, the packets meanwhile, and that neither descriptors nor memory grow. FILM shows no
face, so that the packets' reason tells at once whether frames come ("no face") or not ("no camera").
Exit status 1: something was not as it should be.
"""

import os
import subprocess
import sys
import time
from collections import namedtuple

from receivers import Datagrams, Lag, SerialEnd, Service, await_that, monotonic

# The promise: from a device's link in /dev to the camera's first frame, or to the board's first packet, in seconds. For
# the camera this guest may take as much longer as another program takes for the camera's first frame, and for both as
# much longer as a program that only sleeps wakes up late.
BACK_S = 1.5
# A line that fails sooner after its opening is opened more rarely, and logged once it lasts.
LASTS_S = 1.2
# Longest time between two packets of a face that is neutral, and what emulation may add to it, in seconds.
PERIOD_S = 0.1
SLACK_S = 0.25
# How much the memory of a service may grow once it has seen every kind of round, KiB.
GROWTH_KB = 512
SETTLED_ROUND = 8
FPS = "4"


class Device:
    """A device that can be unplugged. `link` is its stable path."""

    def __init__(self):
        self.kept, self.node = None, None

    def is_there(self):
        """Whether udev has made the link."""
        return os.path.exists(self.link)

    def pull(self, is_kept):
        """Unplugs the device; another program may keep its node open until `release`. Returns when the link was gone."""
        self.node = os.path.realpath(self.link)
        self.release()
        if is_kept:
            self.kept = os.open(self.node, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.unplug()
        await_that(f"{self.link} goes", lambda: not self.is_there())
        return time.monotonic()

    def release(self):
        """Closes the old node."""
        if self.kept is not None:
            os.close(self.kept)
        self.kept = None

    def appeared(self):
        """Waits for the link; returns when udev made it. A device whose old node is kept must have another number."""
        await_that(f"{self.link} comes", self.is_there)
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
        """Begins to plug the camera in."""
        subprocess.Popen(["uvc-camera", "plug", self.film, FPS])

    def unplug(self):
        """Unplugs the device."""
        subprocess.run(["uvc-camera", "unplug"], check=True)


class Serial(Device):
    """The USB serial port."""

    link = "/dev/serial/by-id/usb-Arduino_8036_1234-if00"
    other_end = "/dev/ttyGS0"

    def plug(self):
        """Plugs the port in; makes it the first time."""
        if os.path.exists(self.other_end):
            self.bind(os.listdir("/sys/class/udc")[0])
        else:
            subprocess.run(["usb-acm", "plug"], check=True)

    def unplug(self):
        """Unplugs the device."""
        self.bind("")

    @staticmethod
    def bind(controller):
        """Connects the board to this USB controller, or to none."""
        with open("/sys/kernel/config/usb_gadget/acm/UDC", "w") as file:
            file.write(controller + "\n")


def first_packet_again(service, board, gone):
    """Waits until the service opens the line that went away at the time `gone`.

    Returns the time of the first packet after that. The board may still read a packet that was sent before the line went
    away, so a packet alone does not show that the line is back.
    """
    opened = await_that("the link opens", lambda: service.logged_since(gone, "link opened"))
    return await_that("a packet by the serial port", lambda: board.first_since(opened))


# When the service lost the camera, and when it had the camera again.
Absence = namedtuple("Absence", "lost opened")


def shows_frames(packet):
    """Whether frames come from the camera. The film has no face."""
    return (packet["state"], packet["reason"]) == ("neutral", "no face")


def is_blind(packet):
    """Whether the face is neutral for lack of a camera."""
    return (packet["state"], packet["reason"]) == ("neutral", "no camera")


class Bench:
    """Service, devices and receivers, and what was measured in each round."""

    def __init__(self, film):
        self.camera, self.serial, self.lag = Camera(film), Serial(), Lag()
        self.datagrams, self.board = Datagrams(), SerialEnd(Serial.other_end)
        self.service = None
        self.absences, self.camera_back_s, self.frames_s, self.serial_back_s = [], [], [], []
        self.bare_s, self.descriptors, self.blind_kb = [], [], []

    def start(self, work):
        """Plugs both in and waits until frames come and both receivers get packets."""
        self.camera.plug()
        self.serial.plug()
        self.camera.appeared()
        self.serial.appeared()
        self.time_bare_opening()
        begun = time.monotonic()
        self.service = Service(work)
        self.await_frames(begun)
        await_that("packets by the serial port", lambda: self.board.first_since(begun))

    def time_bare_opening(self):
        """Times a program that opens the camera, takes one frame and ends."""
        for _ in range(3):
            begun = time.monotonic()
            command = ["v4l2-ctl", "--device", Camera.link, "--stream-mmap", "--stream-count=1"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.bare_s.append(time.monotonic() - begun)

    def await_frames(self, since):
        """Waits for a packet after `since` that tells of frames; returns its time."""
        return await_that("frames come", lambda: self.datagrams.first_since(since, shows_frames))

    def pull_camera(self, is_kept):
        """Unplugs the camera and waits for packets that say so."""
        gone = self.camera.pull(is_kept)
        await_that("neutral, no camera", lambda: self.datagrams.first_since(gone, is_blind))
        return gone

    def await_camera(self, gone):
        """Waits until the camera that was `gone` is used again."""
        there = self.camera.appeared()
        opened = await_that("the camera opens", lambda: self.service.logged_since(gone, "camera opened"))
        self.camera_back_s.append(opened - there)
        self.frames_s.append(self.await_frames(opened) - there)
        self.absences.append(Absence(self.service.logged_last("camera lost"), opened))

    def await_serial(self, gone):
        """Waits until packets come by the serial port that was `gone`."""
        there = self.serial.appeared()
        self.serial_back_s.append(first_packet_again(self.service, self.board, gone) - there)

    def round(self, number):
        """Unplugs both and plugs them in again."""
        time.sleep(LASTS_S)
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
    """Returns the middle value, of two the greater. The guest's Python has no module for this."""
    return sorted(values)[len(values) // 2]


def complaints_about_times(name, back_s, limit_s):
    """Complaints about the times of all rounds."""
    print(f"{name} back after {median(back_s):.2f} s, at most {max(back_s):.2f} s (limit {limit_s:.2f} s)")
    if max(back_s) > limit_s:
        yield f"{name}: back after {', '.join(f'{time_s:.2f}' for time_s in back_s)} s"


def complaints_about_order(datagrams, longest_s):
    """Complaints about packets that are missing or late. The loopback interface loses none, but the receiver may drop some."""
    packets = datagrams.packets
    steps = [(later["sequence"] - earlier["sequence"]) % 65536 for (_, earlier), (_, later) in zip(packets, packets[1:])]
    times_s = [later - earlier for (earlier, _), (later, _) in zip(packets, packets[1:])]
    lost = sum(step - 1 for step in steps)
    longest_gap_s = max(time_s for time_s, step in zip(times_s, steps) if step == 1)
    print(f"{len(packets)} packets by UDP, {lost} missing, of which the receiver dropped {datagrams.dropped}, "
          f"at most {longest_gap_s:.2f} s apart")
    if lost > datagrams.dropped:
        yield f"{lost - datagrams.dropped} packets are missing in the sequence"
    if longest_gap_s > longest_s:
        yield f"no packet for {longest_gap_s:.2f} s"


def complaints_about_absence(packets, absence, slack_s):
    """Complaints about the packets while there was no camera: they say so from the loss on until the camera is back."""
    # The sender may be about to send when the loss or the return is logged, and the log is read late.
    begin, end = absence.lost + SLACK_S + slack_s, absence.opened - SLACK_S - slack_s
    reasons = {packet["reason"] for at, packet in packets if begin < at < end}
    if reasons - {"no camera"}:
        yield f"without a camera the reasons were {sorted(reasons)}"


def complaints_about_sizes(descriptors, blind_kb):
    """Complaints about descriptors with everything plugged in, and memory without a camera, in each round."""
    growth_kb = max(blind_kb[SETTLED_ROUND - 1:]) - blind_kb[SETTLED_ROUND - 1]
    print(f"descriptors {sorted(set(descriptors))}, memory without a camera {blind_kb[0]} to {blind_kb[-1]} KiB, "
          f"{growth_kb} KiB of it since round {SETTLED_ROUND}")
    if len(set(descriptors)) > 1:
        yield f"descriptors in each round: {descriptors}"
    if growth_kb > GROWTH_KB:
        yield f"memory in each round: {blind_kb}"


def complaints_about_end(bench, status, rounds):
    """Complaints about how the service ended, and what it logged of each round."""
    last = [(packet["state"], packet["reason"]) for _, packet in bench.datagrams.packets[-3:]]
    if status or bench.service.count("panic"):
        yield f"exit status {status}"
    if last != [("neutral", "stopping")] * 3:
        yield f"its last packets were {last}"
    for text, count in (("camera opened", rounds + 1), ("camera lost", rounds), ("link opened", rounds + 1)):
        if bench.service.count(text) != count:
            yield f"{bench.service.count(text)} times '{text}'"
    for name, end in (("UDP", bench.datagrams), ("serial port", bench.board)):
        if end.refused:
            yield f"{len(end.refused)} packets refused by {name}: {end.refused[0][1]}"


def complaints(bench, status, rounds):
    """All complaints."""
    slack_s = bench.lag.slack_s()
    print(f"another program has a frame after {max(bench.bare_s):.2f} s; sleepers are {bench.lag.worst_s:.2f} s late")
    yield from complaints_about_times("camera", bench.camera_back_s, BACK_S + max(bench.bare_s) + slack_s)
    yield from complaints_about_times("serial port", bench.serial_back_s, BACK_S + slack_s)
    print(f"frames again after {median(bench.frames_s):.2f} s, at most {max(bench.frames_s):.2f} s")
    yield from complaints_about_order(bench.datagrams, PERIOD_S + SLACK_S + slack_s)
    for absence in bench.absences:
        yield from complaints_about_absence(bench.datagrams.packets, absence, slack_s)
    yield from complaints_about_sizes(bench.descriptors, bench.blind_kb)
    yield from complaints_about_end(bench, status, rounds)


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    work, film, rounds = sys.argv[1], sys.argv[2], int(sys.argv[3])
    bench = Bench(film)
    bench.start(work)
    for number in range(1, rounds + 1):
        bench.round(number)
    status = bench.service.stop()
    bench.time_bare_opening()
    if found := list(complaints(bench, status, rounds)):
        sys.exit("\n".join(found[:20]))


if __name__ == "__main__":
    main()
