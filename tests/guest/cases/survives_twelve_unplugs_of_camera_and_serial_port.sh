#!/bin/sh
# In one run, the camera and the serial port are unplugged and plugged in again twelve times each, also under other
# numbers.
. cases/lib.sh
cp receivers.py endurance.py $work
cat >$work/facewire.toml <<CONFIG
[camera]
device = "/dev/v4l/by-id/usb-Test_bench_UVC_Camera_0001-video-index0"
stall_timeout_ms = 30000
[[link]]
address = "127.0.0.1:5252"
[[link]]
kind = "serial"
device = "/dev/serial/by-id/usb-Arduino_8036_1234-if00"
CONFIG
film_without_a_face $work/grey.avi
python3 $work/endurance.py $work $work/grey.avi 12 || fail 'after so many unplugs something is not as it should be'
