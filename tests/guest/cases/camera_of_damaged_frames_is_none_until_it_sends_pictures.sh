#!/bin/sh
# A camera that begins to send damaged frames does not count as a camera until it sends pictures again. Packets keep
# coming, every damaged frame is counted, and the log says so once, however often the camera is opened meanwhile.
. cases/lib.sh
cat >$work/feeder.py <<'FEEDER'
"""Feeds /dev/video0 with the frames of a Motion-JPEG AVI, or with their first halves while the file `damage` exists."""
import fcntl, itertools, os, re, struct, sys, time

film = open(sys.argv[1], "rb").read()
chunks = [match.end() for match in re.finditer(rb"00dc.{4}(?=\xff\xd8)", film, re.DOTALL)]
frames = [film[at:at + struct.unpack_from("<I", film, at - 4)[0]] for at in chunks]
device = open("/dev/video0", "wb", buffering=0)
wanted = struct.pack("=II7I", 2, 0, 640, 480, *struct.unpack("=I", b"MJPG"), 1, 0, 614400, 7)
fcntl.ioctl(device, 0xC0D05605, bytearray(wanted.ljust(208, b"\0")))
for frame in itertools.cycle(frames):
    is_damaged = os.path.exists("damage")
    device.write(frame[:len(frame) // 2] if is_damaged else frame)
    time.sleep(0.1 if is_damaged else 0.25)
FEEDER
cd $work
modprobe v4l2loopback video_nr=0 exclusive_caps=1 max_buffers=8 card_label='Loopback camera'
await test -e /dev/video0
film_without_a_face grey.avi
python3 feeder.py grey.avi &
feeder=$!
captures() { v4l2-ctl -d /dev/video0 --info 2>/dev/null | grep -q 'Video Capture'; }
await captures
configure /dev/video0 mjpeg
start_service
await passed neutral/no_face
touch damage
await passed neutral/no_face neutral/no_camera
# Three attempts to open the camera, each of which gives up after 8 damaged frames.
damaged() { kill -USR1 $service && [ "$(counted damaged)" -ge "$1" ]; }
await damaged 24
rm damage
await passed neutral/no_face neutral/no_camera neutral/no_face
stop_service
kill $feeder
grep -E 'camera (opened|lost)|no camera|stopped' log
passed neutral/no_face neutral/no_camera neutral/no_face neutral/stopping || fail "$(cat judged)"
[ "$(counted damaged)" -ge 24 ] || fail "damaged frames: $(counted damaged)"
[ "$(counted cameras_opened)" = 2 ] || fail "cameras opened: $(counted cameras_opened)"
[ "$(grep -cE '(camera lost|no camera): 8 frames in a row were bad' log)" = 1 ] || fail 'the log says it again and again'
