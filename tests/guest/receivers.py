"""What arrives at the other ends of the service's links, and when; and the service itself, with its log.

All times are of time.monotonic(), the clock of the packets' time of capture. Each end is read by a thread of its own.
"""

import contextlib
import os
import select
import socket
import struct
import subprocess
import sys
import threading
import time

from packet_decoder import cobs_decode, decode

PORT = 5252
# Timestamps by the kernel, in nanoseconds: no delay of this program is in them.
SO_TIMESTAMPNS = 35


def await_that(what, seconds, condition):
    """Waits until the condition holds and returns what it gave; ends the program if it does not in time."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            sys.exit(f"waited {seconds} s in vain: {what}")
        time.sleep(0.01)
    return found


def monotonic(real_s):
    """A moment of the system's clock on the monotonic one."""
    return real_s - time.time() + time.monotonic()


class End:
    """Packets as they came: pairs of time and packet, and what was refused."""

    def __init__(self):
        self.packets, self.refused = [], []
        threading.Thread(target=self.read, daemon=True).start()

    def take(self, time_s, data):
        """Keeps a packet or the reason why it is none."""
        try:
            self.packets.append((time_s, decode(self.unframed(data))))
        except ValueError as error:
            self.refused.append((time_s, error))

    @staticmethod
    def unframed(data):
        """The packet in what came, which is a datagram."""
        return data

    def first_since(self, time_s, wanted=lambda packet: True):
        """The time of the first such packet that came after `time_s`, or None."""
        later = (at for at, packet in self.packets if at >= time_s and wanted(packet))
        return next(later, None)


class Datagrams(End):
    """The receiver by UDP."""

    def read(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
            server.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            server.bind(("127.0.0.1", PORT))
            while True:
                data, [(_, _, stamp)], _, _ = server.recvmsg(2048, 256)
                seconds, nanoseconds = struct.unpack("qq", stamp)
                self.take(monotonic(seconds + nanoseconds / 1e9), data)


class SerialEnd(End):
    """The board at the other end of a serial line; it is opened again after it was pulled out."""

    def __init__(self, path):
        self.path, self.reading = path, threading.Event()
        self.reading.set()
        super().__init__()

    unframed = staticmethod(cobs_decode)

    def read(self):
        while True:
            with contextlib.suppress(OSError):
                self.session(os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
            time.sleep(0.02)

    def session(self, port):
        """Reads until the line is hung up. What comes before the first zero is the rest of a frame."""
        try:
            subprocess.run(["stty", "-F", self.path, "raw", "-echo"], check=False)
            rest, started = b"", False
            while data := self.some_bytes(port):
                now = time.monotonic()
                *frames, rest = (rest + data).split(b"\0")
                for frame in frames:
                    if started and frame:
                        self.take(now, frame)
                    started = True
        finally:
            os.close(port)

    def some_bytes(self, port):
        """Waits for bytes; empty when the line is hung up."""
        while True:
            self.reading.wait()
            if select.select([port], [], [], 0.1)[0]:
                return os.read(port, 4096)


class Service:
    """`facewire run` with the settings of the case.

    What it frees goes back to the system at once, so that its memory shows what it holds and nothing of how the C library
    keeps what ONNX Runtime frees and takes again.
    """

    def __init__(self, work):
        self.lines, self.log = [], open(f"{work}/log", "w")
        command = [f"{work}/facewire", "run", "--config", f"{work}/facewire.toml"]
        environment = {**os.environ, "GLIBC_TUNABLES": "glibc.malloc.mmap_threshold=131072"}
        self.process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        """Notes each line of the log with its time."""
        for line in self.process.stderr:
            self.lines.append((time.monotonic(), line.rstrip()))
            print(line, end="", file=self.log, flush=True)

    def logged_last(self, text):
        """The time of the last line with this text."""
        return next(at for at, line in reversed(self.lines) if text in line)

    def logged_since(self, time_s, text):
        """The time of the first line with this text that was written after `time_s`, or None."""
        return next((at for at, line in self.lines if at >= time_s and text in line), None)

    def count(self, text):
        """How many lines have this text."""
        return sum(text in line for _, line in self.lines)

    def last_line(self):
        """The last line of the log."""
        return self.lines[-1][1]

    def descriptors(self):
        """How many descriptors it has open."""
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def resident_kb(self):
        """How much memory it has."""
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))

    def stop(self):
        """Ends it as systemd does; its exit status."""
        self.process.terminate()
        return self.process.wait(10)
