#!/bin/sh
# A board's own serial port, a 16550 at /dev/ttyS1: all frames leave it whole and in order, up to the last word. They are
# judged by what QEMU has of the other end of the line.
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
await 60 passed live
sleep 3
stop_service
[ "$(counted dropped)" = 0 ] || fail "dropped packets: $(counted dropped)"
sync
python3 $work/judge.py line uart live neutral/stopping neutral/stopping neutral/stopping || fail 'not what was sent'
# Each frame ends with a zero, and the link begins with one of its own.
echo "$(($(tr -dc '\000' <uart | wc -c) - 1)) frames by UART, $(stty -F /dev/ttyS1 speed) baud"
