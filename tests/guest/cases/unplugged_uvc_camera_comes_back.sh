#!/bin/sh
# After the camera is unplugged in mid-stream the face holds, decays and is neutral, and the packets say why. After it is
# plugged in again the face is live again.
. cases/lib.sh
uvc-camera plug $work/demo.avi 4
configure auto
start_service
await passed live
uvc-camera unplug
await passed live hold/no_camera decay/no_camera neutral/no_camera
await logged 1 'camera lost'
uvc-camera plug $work/demo.avi 4
await passed live neutral/no_camera live
stop_service
grep -E 'camera (opened|lost)|no camera' $work/log
passed live neutral/no_camera live neutral/stopping || fail "$(cat $work/judged)"
