#!/bin/sh
# One run, in which the camera and the serial port go and come back twenty times each, also under other numbers.
. cases/lib.sh
cp receivers.py endurance.py $work
cat >$work/facewire.toml <<CONFIG
[camera]
device = "/dev/v4l/by-id/usb-Test_bench_UVC_Camera_0001-video-index0"
stall_timeout_ms = 5000
[failsafe]
live_ms = 2000
hold_ms = 2300
neutral_ms = 2600
[send]
rate_hz = 20
[[link]]
address = "127.0.0.1:5252"
[[link]]
kind = "serial"
device = "/dev/serial/by-id/usb-Arduino_0043_1234-if00"
CONFIG
python3 $work/endurance.py $work 20 || fail 'after so many unplugs something is not as it should be'
