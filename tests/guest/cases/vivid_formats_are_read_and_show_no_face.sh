#!/bin/sh
# A test pattern in every raw format: the service reads frames, none is damaged, and it sees no face.
. cases/lib.sh
modprobe vivid n_devs=1 node_types=0x1
await test -e /dev/video0
for format in yuyv nv12 grey; do
    configure /dev/video0 $format
    start_service
    await passed neutral/no_face
    await read_frames 3
    stop_service
    grep -o 'camera opened: .*' $work/log
    grep -qi "camera opened: .*$format" $work/log || fail "the camera was not opened in $format"
    passed neutral/no_face neutral/stopping || fail "$format: $(cat $work/judged)"
    ! grep -q ',live,' $work/packets.csv || fail "$format: a face was seen"
    [ "$(counted damaged)" = 0 ] || fail "$format: damaged frames: $(counted damaged)"
done
