#!/bin/sh
# With two cameras, of which another program uses the first, the service takes the second, and says why. A webcam on USB
# comes before both.
. cases/lib.sh
cd $work
modprobe vivid n_devs=2 node_types=0x1,0x1
await test -e /dev/video1
v4l2-ctl -d /dev/video0 --stream-mmap --stream-count=1000000 >/dev/null 2>streaming &
other=$!
# v4l2-ctl writes a sign for each frame.
await test -s streaming
configure auto
start_service
logged 1 'camera opened: vivid (/dev/video1; passed over /dev/video0, because /dev/video0 is in use by another program' ||
    fail 'the log does not say which camera was passed over, and why'
await passed neutral/no_face
kill $other
stop_service
# A webcam on USB comes before cameras that are on none.
uvc-camera plug $work/demo.avi 10
await test -e /dev/video2
configure auto
start_service
logged 1 'camera opened: UVC Camera' || fail 'the webcam on USB does not come first'
stop_service
uvc-camera unplug
grep 'camera opened' log
