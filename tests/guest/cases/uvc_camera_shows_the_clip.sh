#!/bin/sh
# A USB webcam, by the kernel's own driver, in Motion-JPEG.
. cases/lib.sh
play() { uvc-camera plug $work/demo.avi "$1"; }
stop_playing() { uvc-camera unplug; }
configure auto
show_clip
