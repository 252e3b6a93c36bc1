"""The receivers at the other ends of the service's links, and the service itself with its log.

All times are those of time.monotonic(), the clock of the packets' time of capture. A thread of its own reads each end.
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

from facewire_packet import cobs_decode, decode

PORT = 5252
# Timestamps by the kernel, in nanoseconds: no delay of this program is in them.
SO_TIMESTAMPNS = 35
# The number of packets that the kernel has dropped because this program did not read the earlier ones in time.
SO_RXQ_OVFL = 40

# Longest wait for a state, in seconds. On a busy machine emulation is slow.
PATIENCE_S = 600


def await_that(what, condition):
    """Waits until the condition holds and returns its value; ends the program if that takes too long."""
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > end:
            sys.exit(f"waited {PATIENCE_S} s in vain: {what}")
        time.sleep(0.01)
    return found


class Lag:
    """Measures by how much this guest is late: how long past its time a program wakes up that does nothing but sleep.

    A promise in seconds is judged with this added for each of the few times that a program has to wake up in it.
    """

    period_s = 0.02
    wakes = 3

    def __init__(self):
        self.worst_s = 0.0
        threading.Thread(target=self.measure, daemon=True).start()

    def measure(self):
        """Sleeps again and again."""
        while True:
            begun = time.monotonic()
            time.sleep(self.period_s)
            self.worst_s = max(self.worst_s, time.monotonic() - begun - self.period_s)

    def slack_s(self):
        """What a promise in seconds may take longer in this guest."""
        return self.wakes * self.worst_s


def monotonic(real_s):
    """Converts a moment of the system's clock to the monotonic clock."""
    return real_s - time.time() + time.monotonic()


class End:
    """The packets as they came, in pairs of time and packet, and the data that were refused."""

    def __init__(self):
        self.packets, self.refused = [], []
        threading.Thread(target=self.read, daemon=True).start()

    def take(self, time_s, data):
        """Keeps a packet, or the reason why the data are not a packet."""
        try:
            self.packets.append((time_s, decode(self.unframed(data))))
        except ValueError as error:
            self.refused.append((time_s, error))

    @staticmethod
    def unframed(data):
        """Returns the packet in the data. A datagram is one packet."""
        return data

    def first_since(self, time_s, wanted=lambda packet: True):
        """Returns the time of the first wanted packet that came after `time_s`, or None."""
        later = (at for at, packet in self.packets if at >= time_s and wanted(packet))
        return next(later, None)


class Datagrams(End):
    """The UDP receiver. `dropped` counts the packets that reached this machine, but not this program."""

    dropped = 0

    def read(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
            server.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            server.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
            server.bind(("127.0.0.1", PORT))
            while True:
                data, told, _, _ = server.recvmsg(2048, 256)
                told = {kind: content for _, kind, content in told}
                seconds, nanoseconds = struct.unpack("qq", told[SO_TIMESTAMPNS])
                # Until it drops a packet, the kernel gives no count.
                self.dropped = int.from_bytes(told.get(SO_RXQ_OVFL, b""), "little")
                self.take(monotonic(seconds + nanoseconds / 1e9), data)


class SerialEnd(End):
    """The board at the other end of a serial line. The line is opened again after it was unplugged."""

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
        """Reads until the line is hung up. The bytes before the first zero are the rest of a frame."""
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
        """Waits for bytes and returns them; returns none when the line is hung up."""
        while True:
            self.reading.wait()
            if select.select([port], [], [], 0.1)[0]:
                return os.read(port, 4096)


class Service:
    """`facewire run` with the settings of the case.

    Memory that it frees goes back to the system at once. So its size does not depend on how much freed memory the C
    library keeps for the next allocation of ONNX Runtime.
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
        """Returns the time of the last line with this text."""
        return next(at for at, line in reversed(self.lines) if text in line)

    def logged_since(self, time_s, text):
        """Returns the time of the first line with this text that was written after `time_s`, or None."""
        return next((at for at, line in self.lines if at >= time_s and text in line), None)

    def count(self, text):
        """Returns how many lines have this text."""
        return sum(text in line for _, line in self.lines)

    def last_line(self):
        """Returns the last line of the log."""
        return self.lines[-1][1]

    def descriptors(self):
        """Returns how many descriptors the process has open."""
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def resident_kb(self):
        """Returns the resident memory of the process."""
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))

    def stop(self):
        """Ends the service as systemd does; returns its exit status."""
        self.process.terminate()
        return self.process.wait(PATIENCE_S)
