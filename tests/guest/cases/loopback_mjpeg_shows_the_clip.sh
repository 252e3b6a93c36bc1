#!/bin/sh
# v4l2loopback in Motion-JPEG.
. cases/lib.sh
feed-video $work/demo.avi mjpeg "$speed"
configure /dev/video0 mjpeg
show_clip
