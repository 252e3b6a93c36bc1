#!/bin/sh
# v4l2loopback in YUYV: the packets show the face of the clip, in 8 frames with eyes and mouth wide open and shut.
. cases/lib.sh
configure /dev/video0 yuyv
show_clip yuyv 8 20 24 48 92 100 104 220
