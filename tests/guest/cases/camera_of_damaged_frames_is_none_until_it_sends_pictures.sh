#!/bin/sh
# A camera that begins to send rubbish is none until it sends pictures again. Packets keep coming, every damaged frame counts,
# and the log says so once, however often the camera is opened meanwhile.
. cases/lib.sh
cat >$work/feeder.py <<'FEEDER'
"""Feeds /dev/video0 with the frames of a Motion-JPEG AVI, or with halves of them and noise while the file `rubbish` is there."""
import fcntl, itertools, os, re, struct, sys, time

film = open(sys.argv[1], "rb").read()
chunks = [match.end() for match in re.finditer(rb"00dc.{4}(?=\xff\xd8)", film, re.DOTALL)]
frames = [film[at:at + struct.unpack_from("<I", film, at - 4)[0]] for at in chunks]
device = open("/dev/video0", "wb", buffering=0)
wanted = struct.pack("=II7I", 2, 0, 640, 480, *struct.unpack("=I", b"MJPG"), 1, 0, 614400, 7)
fcntl.ioctl(device, 0xC0D05605, bytearray(wanted.ljust(208, b"\0")))
for number, frame in enumerate(itertools.cycle(frames)):
    is_rubbish = os.path.exists("rubbish")
    device.write([frame[:len(frame) // 2], os.urandom(5000)][number % 2] if is_rubbish else frame)
    time.sleep(0.1 if is_rubbish else 0.25)
FEEDER
cd $work
modprobe v4l2loopback video_nr=0 exclusive_caps=1 max_buffers=8 card_label='Loopback camera'
await 10 test -e /dev/video0
python3 feeder.py demo.avi &
feeder=$!
captures() { v4l2-ctl -d /dev/video0 --info 2>/dev/null | grep -q 'Video Capture'; }
await 20 captures
configure /dev/video0 mjpeg
start_service
await 60 passed live
touch rubbish
await 60 passed live neutral/no_camera
sleep 8
rm rubbish
await 60 passed live neutral/no_camera live
stop_service
kill $feeder
grep -E 'camera (opened|lost)|no camera|stopped' log
passed live neutral/no_camera live neutral/stopping || fail "$(cat judged)"
[ "$(counted damaged)" -ge 24 ] || fail "damaged frames: $(counted damaged)"
[ "$(counted cameras_opened)" = 2 ] || fail "cameras opened: $(counted cameras_opened)"
[ "$(grep -c 'frames in a row were bad' log)" -le 2 ] || fail 'it is told again and again'
