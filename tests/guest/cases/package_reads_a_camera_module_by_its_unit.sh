#!/bin/sh
# facewire-camera.service runs rpicam-vid in its sandbox, with the size and the rate of a drop-in, and the service takes its images
# as `auto`, again after rpicam-vid has ended. No driver of a Raspberry Pi's camera module runs here: a program that knows the
# options of rpicam-vid, and refuses others, stands in for it, and shows a frame of the built-in clip.
. cases/lib.sh
. cases/package.sh

install_package facewire.deb
configure auto
install -m 644 $work/facewire.toml /etc/facewire/facewire.toml
ffmpeg -nostdin -v error -i $work/demo.avi -frames:v 1 /usr/share/face.jpg
cat >/usr/bin/rpicam-vid <<'PROGRAM'
#!/bin/sh
is_flushed=
while [ $# -gt 0 ]; do
    case $1 in
    --nopreview) ;;
    --flush) is_flushed=yes ;;
    --timeout) [ "$2" = 0 ] && shift || exit 1 ;;
    --codec) [ "$2" = mjpeg ] && shift || exit 1 ;;
    --quality) shift ;;
    --width) width=$2 && shift ;;
    --height) height=$2 && shift ;;
    --framerate) fps=$2 && shift ;;
    --output) output=$2 && shift ;;
    *) exit 1 ;;
    esac
    shift
done
[ "$is_flushed" ] || exit 1
exec ffmpeg -nostdin -v error -y -re -loop 1 -framerate "$fps" -i /usr/share/face.jpg -s "${width}x$height" -c:v mjpeg -q:v 3 \
    -f mjpeg "$output"
PROGRAM
chmod 755 /usr/bin/rpicam-vid
mkdir /etc/systemd/system/facewire-camera.service.d
printf '[Service]\nEnvironment=WIDTH=320 HEIGHT=240 FPS=2\n' >/etc/systemd/system/facewire-camera.service.d/size.conf
systemctl daemon-reload

: >$work/refused
start_decoder
systemctl enable --now facewire-camera 2>$work/said || fail "$(journalctl --unit facewire-camera --output cat)"
[ "$(systemctl show --property UID --value facewire-camera)" -ge 61184 ] || fail 'rpicam-vid runs as another user'
pipe=/run/facewire-camera/video
[ "$(stat --format '%U %G %a %F' $pipe)" = 'root video 660 fifo' ] || fail "$(ls -l $pipe)"
systemctl start facewire || fail "$(systemctl status facewire)"
await told 1 "camera opened: $pipe: JPEG 320x240"
await seen live

systemctl stop facewire-camera
await told 1 "camera lost: $pipe has no writer any more"
systemctl start facewire-camera
await told 2 "camera opened: $pipe"
