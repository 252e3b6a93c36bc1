#!/bin/sh
# A USB webcam, by the kernel's own driver, in Motion-JPEG: the packets show the face of the clip, from its first frame to its last.
. cases/lib.sh
configure auto
# shellcheck disable=SC2046
show_clip uvc $(seq 0 4 239)
