#!/bin/sh
# Pulled out in mid-stream the camera leaves packets that say so; plugged in again it is live again.
. cases/lib.sh
uvc-camera plug $work/demo.avi 4
configure auto
start_service
await 30 passed live
uvc-camera unplug
await 30 passed live neutral/no_camera
await 5 logged 1 'camera lost'
uvc-camera plug $work/demo.avi 4
await 30 passed live neutral/no_camera live
stop_service
grep -E 'camera (opened|lost)|no camera' $work/log
passed live neutral/no_camera live neutral/stopping || fail "$(cat $work/judged)"
