"""Receivers of OSC on a machine of their own, which python-zeroconf advertises as VRChat does, and a liar beside them.

vrchat.py INTERFACE ADDRESS

Waits until the interface is here, and gives it the address. Then it prints a line. VRChat starts with the next line of input.
"""

import socket
import struct
import subprocess
import sys
import threading
import time

from zeroconf import ServiceInfo, Zeroconf

GROUP = "224.0.0.251"
# A name that goes on with itself, and counts of records that are not there.
LOOP = b"\xc0\x0c\0\x21\0\1"


def appear(interface, address):
    """Waits for an interface that is moved here, and brings it up."""
    while subprocess.run(["ip", "link", "show", interface], capture_output=True).returncode:
        time.sleep(0.01)
    for command in ("link set lo up", f"address add {address}/24 dev {interface}", f"link set {interface} up"):
        subprocess.run(["ip", *command.split()], check=True)


def lie(address):
    """Answers each question at once with what no program should trip over."""
    ears = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ears.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ears.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    ears.bind(("", 5353))
    ears.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(address))
    while True:
        question, asker = ears.recvfrom(9000)
        if asker[1] == 5353:
            continue
        head = question[:2] + b"\x84\0"
        for answer in (
            b"", head, head + struct.pack("!4H", 0, 65535, 65535, 65535), head + struct.pack("!4H", 0, 1, 0, 0) + LOOP,
            head + struct.pack("!4H", 65535, 0, 0, 0) + 4000 * b"\0", question,
        ):
            ears.sendto(answer, asker)


def advertise(zeroconf, name, address, port):
    """Advertises a receiver. VRChat gives 127.0.0.1 as its address, whatever machine it runs on."""
    service = "_osc._udp.local."
    place = {"addresses": [socket.inet_aton(address)], "port": port, "server": f"{name}.osc.local."}
    zeroconf.register_service(ServiceInfo(service, f"{name}.{service}", **place))


def main():
    """Advertises another program, and VRChat when it is asked to."""
    interface, address = sys.argv[1:]
    appear(interface, address)
    threading.Thread(target=lie, args=(address,), daemon=True).start()
    zeroconf = Zeroconf(interfaces=[address])
    advertise(zeroconf, "VRCFaceTracking-7K2M9Q", address, 9001)
    print("ready", flush=True)
    sys.stdin.readline()
    advertise(zeroconf, "VRChat-Client-9F3A21", "127.0.0.1", 9000)
    sys.stdin.read()


if __name__ == "__main__":
    main()
