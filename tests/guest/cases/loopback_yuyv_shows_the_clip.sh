#!/bin/sh
# v4l2loopback in YUYV: the packets show the face of the clip, in 8 frames in which eyes and mouth open and close.
. cases/lib.sh
configure /dev/video0 yuyv
show_clip yuyv 196 228 4
