#!/bin/sh
# When the board at a USB serial port stops reading, the receiver by UDP still gets every packet, and the board gets fresh
# packets as soon as it reads again.
. cases/lib.sh
cp receivers.py endurance.py stalled.py $work
configure /dev/video9
cat >>$work/facewire.toml <<CONFIG
[[link]]
kind = "serial"
device = "/dev/serial/by-id/usb-Arduino_8036_1234-if00"
CONFIG
python3 $work/stalled.py $work || fail 'the service does not cope with a board that does not read'
