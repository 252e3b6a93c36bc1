#!/bin/sh
# A camera whose driver drops frames, as a driver does for which the bus is too slow: its numbers have gaps. The service says
# so, and says when it has passed.
. cases/lib.sh
modprobe vivid n_devs=1 node_types=0x1
await test -e /dev/video0
configure /dev/video0 grey
sed -i 's/^format.*/&\nwidth = 320\nheight = 180\nfps = 1/' $work/facewire.toml
start_service

# impaired_by NAMES: this is what the status line says that tracking is impaired by
impaired_by() {
    kill -USR1 "$service"
    grep impaired_by= $work/log | tail -n 1 | grep -q " impaired_by=$1 "
}

await read_frames 3
await impaired_by none
v4l2-ctl -d /dev/video0 --set-ctrl=percentage_of_dropped_buffers=70
await impaired_by missing-frames
logged 1 'frames get lost or damaged between camera and board'
v4l2-ctl -d /dev/video0 --set-ctrl=percentage_of_dropped_buffers=0
await impaired_by none
stop_service
