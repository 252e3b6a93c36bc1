#!/bin/sh
# `facewire check` refuses whatever cannot be used as a camera with exit status 66. 78 is for bad settings alone.
. cases/lib.sh
refuses 66 auto auto 'there is no camera'
refuses 66 /dev/video7 auto 'no camera is called /dev/video7'
refuses 66 /dev/ttyS1 auto '/dev/ttyS1 is not a camera'
refuses 66 /dev/tty auto '/dev/tty is not a camera'
refuses 66 /host auto '/host is not a camera'

uvc-camera plug $work/demo.avi 10
refuses 66 /dev/video1 auto '/dev/video1 is not a camera'
refuses 66 webcam auto 'no camera is called webcam; there is UVC Camera'
refuses 66 /dev/video0 yuyv '/dev/video0 does not offer YUYV; set camera.format to a format it offers \(MJPEG\)'
refuses 78 /dev/video0 rgb 'camera.format = "rgb": give one of'
v4l2-ctl -d /dev/video0 --stream-mmap --stream-count=100000 >/dev/null 2>$work/streaming &
other=$!
# v4l2-ctl writes a sign for each frame.
await test -s $work/streaming
refuses 66 /dev/video0 auto '/dev/video0 is in use by another program'
kill $other
uvc-camera unplug

# A program that feeds a loopback camera may set a value that the kernel does not define, here a field order of 77.
modprobe v4l2loopback video_nr=7 exclusive_caps=0
await test -e /dev/video7
python3 - <<'FEEDER' &
import fcntl, struct, time
fmt = struct.pack("=II7I", 2, 0, 640, 480, *struct.unpack("=I", b"YUYV"), 77, 1280, 614400, 8)
device = open("/dev/video7", "r+b", buffering=0)
fcntl.ioctl(device, 0xC0D05605, bytearray(fmt.ljust(208, b"\0")))
device.write(bytes(614400))
open("/run/fed", "w").close()
time.sleep(600)
FEEDER
feeder=$!
await test -e /run/fed
refuses 66 /dev/video7 auto 'the driver of /dev/video7 returned a value that the kernel does not define .Invalid field order'
refuses 66 auto auto 'the driver of /dev/video7 returned a value'
kill $feeder
