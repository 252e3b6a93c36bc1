#!/bin/sh
# A camera that is plugged in again gets another number while a program keeps the old node open. The service finds it
# all the same, by a part of its name or by the USB socket that it is in.
. cases/lib.sh
film_without_a_face $work/grey.avi
for device in 'uvc camera' /dev/v4l/by-path/platform-vhci_hcd.0-usb-0:1:1.0-video-index0; do
    uvc-camera plug $work/grey.avi 4
    configure "$device"
    start_service
    logged 1 'camera opened: UVC Camera (/dev/video0)' || fail 'it began with another number'
    exec 7</dev/video0
    uvc-camera unplug
    await logged 1 'camera lost'
    uvc-camera plug $work/grey.avi 4
    await logged 1 'camera opened: UVC Camera (/dev/video1)'
    await passed neutral/no_camera neutral/no_face
    stop_service
    exec 7<&-
    uvc-camera unplug
    echo "$device: $(grep -o 'camera opened: .*' $work/log | tail -n 1)"
done
