#!/bin/sh
# What is no usable camera is refused by `facewire check` with exit status 66; 78 is for bad settings alone.
. cases/lib.sh
refuses 66 auto auto 'there is no camera'
refuses 66 /dev/video7 auto 'no camera is called /dev/video7'
refuses 66 /dev/ttyS1 auto '/dev/ttyS1 is not a camera'
refuses 66 /dev/tty auto '/dev/tty is not a camera'
refuses 66 /host auto '/host is not a camera'

uvc-camera plug $work/demo.avi 10
refuses 66 /dev/video1 auto '/dev/video1 is not a camera'
refuses 66 webcam auto 'no camera is called webcam; there is UVC Camera'
refuses 66 /dev/video0 yuyv '/dev/video0 does not offer YUYV; set camera.format to one it has \(MJPEG\)'
refuses 78 /dev/video0 rgb 'camera.format = "rgb": give one of'
v4l2-ctl -d /dev/video0 --stream-mmap --stream-count=100000 >/dev/null 2>&1 &
other=$!
sleep 2
refuses 66 /dev/video0 auto '/dev/video0 is in use by another program'
kill $other
