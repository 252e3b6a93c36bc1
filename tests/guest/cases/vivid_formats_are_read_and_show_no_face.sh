#!/bin/sh
# A test pattern in every raw format, by both of the kernel's interfaces: the service reads frames, none is damaged, their
# colours are right, and it sees no face.
. cases/lib.sh
load_vivid() {
    modprobe vivid n_devs=1 node_types=0x1 multiplanar="$1"
    await test -e /dev/video0
}
load_vivid 1
for test in 1:yuyv 1:nv12 1:grey 2:yuyv 2:nv12; do
    format=${test#*:}
    # From the first format of the other interface on.
    if [ $test = 2:yuyv ]; then
        await modprobe -r vivid
        load_vivid 2
        v4l2-ctl --device /dev/video0 --info | grep -q 'Video Capture Multiplanar' || fail 'vivid is not multi-planar'
    fi
    configure /dev/video0 "$format"
    printf '[console]\npicture = true\n' >>$work/facewire.toml
    start_service
    await passed neutral/no_face
    await read_frames 3
    [ "$format" = grey ] || python3 colours.py "$format" || fail "$test: the picture is wrong"
    stop_service
    grep -o 'camera opened: .*' $work/log
    grep -qi "camera opened: .*$format" $work/log || fail "the camera was not opened in $format"
    passed neutral/no_face neutral/stopping || fail "$format: $(cat $work/judged)"
    ! grep -q ',live,' $work/packets.csv || fail "$format: a face was seen"
    [ "$(counted damaged)" = 0 ] || fail "$format: damaged frames: $(counted damaged)"
done
