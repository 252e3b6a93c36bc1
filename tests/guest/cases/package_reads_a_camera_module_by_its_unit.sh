#!/bin/sh
# facewire-camera.service runs rpicam-vid in its sandbox, with the size of a drop-in, and the service takes its raw pictures as
# `auto`. It takes them again after rpicam-vid was killed. No driver of a Raspberry Pi's camera module runs here: a program that
# takes the options of the unit stands in for rpicam-vid, and shows a frame of the built-in clip.
. cases/lib.sh
. cases/package.sh

install_package facewire.deb
configure auto
sed -i 's/^\[camera\]$/&\nfps = 2/' $work/facewire.toml
install -m 644 $work/facewire.toml /etc/facewire/facewire.toml
ffmpeg -nostdin -v error -i $work/demo.avi -frames:v 1 /usr/share/face.jpg
cat >/usr/bin/rpicam-vid <<'PROGRAM'
#!/bin/sh
while [ $# -gt 1 ]; do
    case $1 in
    --codec) [ "$2" = yuv420 ] || exit 1 ;;
    --width) width=$2 ;;
    --height) height=$2 ;;
    --output) output=$2 ;;
    esac
    shift
done
exec ffmpeg -nostdin -v error -y -re -loop 1 -framerate 2 -i /usr/share/face.jpg -s "${width}x$height" -pix_fmt yuvj420p \
    -f rawvideo "$output"
PROGRAM
chmod 755 /usr/bin/rpicam-vid
mkdir /etc/systemd/system/facewire-camera.service.d
printf '[Service]\nEnvironment=WIDTH=320 HEIGHT=240 FPS=2\n' >/etc/systemd/system/facewire-camera.service.d/size.conf
systemctl daemon-reload

: >$work/refused
start_decoder
systemctl enable --now facewire-camera 2>$work/said || fail "$(journalctl --unit facewire-camera --output cat)"
# The pipe of another size does not stay.
pipe=/run/facewire-camera/video-320x240.yu12
mkfifo /run/facewire-camera/video-640x480.yu12
systemctl restart facewire-camera
[ "$(ls /run/facewire-camera)" = "${pipe##*/}" ] || fail "$(ls /run/facewire-camera)"
systemctl start facewire || fail "$(systemctl status facewire)"
await told 1 "camera opened: $pipe: YU12 320x240"
await seen live
[ "$(systemctl show --property UID --value facewire-camera)" -ge 61184 ] || fail 'rpicam-vid runs as another user'

systemctl kill --signal KILL facewire-camera
await told 1 "camera lost: $pipe has no writer any more"
await told 2 "camera opened: $pipe"
