#!/bin/sh
# v4l2loopback in Motion-JPEG: the packets show the face of the clip, in 8 frames in which eyes and mouth open and close.
. cases/lib.sh
configure /dev/video0 mjpeg
show_clip mjpeg 196 228 4
