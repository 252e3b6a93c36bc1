#!/bin/sh
# Plugged in again, the camera has another number, for a program keeps the old node open. By a part of its name, or by the
# socket that it is in, it is found all the same.
. cases/lib.sh
for device in 'uvc camera' /dev/v4l/by-path/platform-vhci_hcd.0-usb-0:1:1.0-video-index0; do
    uvc-camera plug $work/demo.avi 4
    configure "$device"
    start_service
    logged 1 'camera opened: UVC Camera (/dev/video0)' || fail 'it began with another number'
    exec 7</dev/video0
    uvc-camera unplug
    await 20 logged 1 'camera lost'
    uvc-camera plug $work/demo.avi 4
    await 30 logged 1 'camera opened: UVC Camera (/dev/video1)'
    await 60 passed neutral/no_camera live
    stop_service
    exec 7<&-
    uvc-camera unplug
    echo "$device: $(grep -o 'camera opened: .*' $work/log | tail -n 1)"
done
