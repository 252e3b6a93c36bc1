#!/bin/sh
# v4l2loopback in YUYV.
. cases/lib.sh
feed-video $work/demo.avi yuyv "$speed"
configure /dev/video0 yuyv
show_clip
