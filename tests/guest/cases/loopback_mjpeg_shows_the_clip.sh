#!/bin/sh
# v4l2loopback in Motion-JPEG: the packets show the face of the clip.
. cases/lib.sh
play() { feed-video $work/clip.avi mjpeg "$1"; }
stop_playing() { feed-video stop; }
configure /dev/video0 mjpeg
show_clip
