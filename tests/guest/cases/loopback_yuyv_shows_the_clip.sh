#!/bin/sh
# v4l2loopback in YUYV.
. cases/lib.sh
play() { feed-video $work/demo.avi yuyv "$1"; }
stop_playing() { feed-video stop; }
configure /dev/video0 yuyv
show_clip
