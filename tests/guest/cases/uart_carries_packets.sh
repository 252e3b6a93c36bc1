#!/bin/sh
# A board's own serial port, a 16550 at /dev/ttyS1: all frames leave the port whole and in order, up to the last packet.
# The bytes are those that QEMU received at the other end of the line.
. cases/lib.sh
configure demo
cat >>$work/facewire.toml <<CONFIG
[[link]]
kind = "serial"
device = "/dev/ttyS1"
[send]
rate_hz = 20
CONFIG
start_service
logged 1 'link opened: /dev/ttyS1 at 115200 baud' || fail 'the port was not opened'
await passed live
read_packets() { [ "$(wc -l <$work/packets.csv)" -ge "$1" ]; }
await read_packets $(($(wc -l <$work/packets.csv) + 60))
stop_service
sync
python3 $work/judge.py line uart "$(counted dropped)" live neutral/stopping neutral/stopping neutral/stopping || fail 'the line carried other packets than were sent'
# Each frame ends with a zero, and the link begins with an extra zero.
echo "$(counted dropped) packets dropped, $(($(tr -dc '\000' <uart | wc -c) - 1)) frames by UART, $(stty -F /dev/ttyS1 speed) baud"
