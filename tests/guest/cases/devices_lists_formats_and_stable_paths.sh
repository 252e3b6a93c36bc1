#!/bin/sh
# `facewire devices` lists every camera with its formats, the USB camera with its stable path, and no other video node.
. cases/lib.sh
uvc-camera plug $work/demo.avi 10
modprobe vivid n_devs=1 node_types=0x1
await test -e /dev/video2
$work/facewire devices >$work/log 2>&1 || fail "facewire devices: exit status $?"
lists() { grep -q -- "$1" $work/log || fail "facewire devices does not list $1"; }
lists 'camera /dev/video0 "UVC Camera'
lists 'stable path /dev/v4l/by-id/usb-Test_bench_UVC_Camera_0001-video-index0'
lists 'MJPEG 640x480'
lists 'camera /dev/video2 "vivid"'
lists YUYV
lists NV12
lists GREY
! grep -q /dev/video1 $work/log || fail 'facewire devices lists a node that is no camera'
head -n 4 $work/log
