#!/bin/sh
# v4l2loopback in Motion-JPEG.
. cases/lib.sh
play() { feed-video $work/demo.avi mjpeg "$1"; }
stop_playing() { feed-video stop; }
configure /dev/video0 mjpeg
show_clip
