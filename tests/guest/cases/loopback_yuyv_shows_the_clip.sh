#!/bin/sh
# v4l2loopback in YUYV: the packets show the face of the clip, in 8 frames with eyes and mouth wide open and shut.
. cases/lib.sh
configure /dev/video0 yuyv
# shellcheck disable=SC2086,SC2154
show_clip yuyv $frames
