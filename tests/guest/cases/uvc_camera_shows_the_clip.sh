#!/bin/sh
# A USB webcam, by the kernel's own driver, in Motion-JPEG: the packets show the face of the clip, in 8 frames with eyes and
# mouth wide open and shut, or in 60 from its first to its last.
. cases/lib.sh
configure auto
[ ! -e all ] || frames=$(seq 0 4 239)
# shellcheck disable=SC2086
show_clip uvc $frames
