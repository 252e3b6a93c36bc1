#!/bin/sh
# v4l2loopback in YUYV: the packets show the face of the clip.
. cases/lib.sh
play() { feed-video $work/clip.avi yuyv "$1"; }
stop_playing() { feed-video stop; }
configure /dev/video0 yuyv
show_clip
