#!/bin/sh
# A USB webcam, by the kernel's own driver, in Motion-JPEG: the packets show the face of the clip.
. cases/lib.sh
play() { uvc-camera plug $work/clip.avi "$1"; }
stop_playing() { uvc-camera unplug; }
configure auto
show_clip
