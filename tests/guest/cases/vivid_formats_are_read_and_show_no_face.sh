#!/bin/sh
# A test pattern in every raw format: frames are read, none is damaged, and no face is seen in them.
. cases/lib.sh
modprobe vivid n_devs=1 node_types=0x1
await 10 test -e /dev/video0
for format in yuyv nv12 grey; do
    configure /dev/video0 $format
    start_service
    await 30 passed neutral/no_face
    sleep 2
    stop_service
    grep -o 'camera opened: .*' $work/log
    grep -qi "camera opened: .*$format" $work/log || fail "the camera was not opened in $format"
    passed neutral/no_face neutral/stopping || fail "$format: $(cat $work/judged)"
    ! grep -q ',live,' $work/packets.csv || fail "$format: a face was seen"
    [ "$(counted damaged)" = 0 ] || fail "$format: damaged frames: $(counted damaged)"
    [ "$(counted frames)" -ge 2 ] || fail "$format: frames read: $(counted frames)"
done
