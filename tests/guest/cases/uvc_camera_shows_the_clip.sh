#!/bin/sh
# A USB webcam, by the kernel's own driver, in Motion-JPEG.
. cases/lib.sh
uvc-camera plug $work/demo.avi $fps
configure auto
show_clip
