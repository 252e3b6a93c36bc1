#!/bin/sh
# The installed unit starts without a camera, as a user of its own, and takes a camera that comes later, a UART and a USB
# serial port. systemd starts it again after it was killed, and after the process or one of its threads got stuck. Bad
# settings are refused while it runs, and end it for good when it starts. systemd grants real time. Without any network
# the service sends by a serial port.
. cases/lib.sh

configuration=/etc/facewire/facewire.toml

journal() { journalctl --unit facewire --output cat >$work/log; }
told() { journal && logged "$@"; }
property() { systemctl show --property "$1" --value facewire; }
is_active() { [ "$(property ActiveState)" = active ]; }
is_another() { is_active && [ "$(property MainPID)" != "$1" ]; }
opens() { readlink /proc/"$1"/fd/* | grep -q "^$2"; }
is_refused() { [ "$(property ActiveState) $(property ExecMainStatus)" = 'failed 78' ]; }

# The names that an operator gives to a camera and a board.
cat >/etc/udev/rules.d/99-facewire-names.rules <<RULES
SUBSYSTEM=="video4linux", ATTR{index}=="0", ATTRS{idVendor}=="1d6b", ATTRS{idProduct}=="0102", SYMLINK+="facewire-eye"
SUBSYSTEM=="tty", ATTRS{idVendor}=="2341", ATTRS{idProduct}=="8036", ATTRS{serial}=="1234", SYMLINK+="facewire-head"
RULES
systemd/install --binary facewire --networks networks >$work/installed || fail "$(cat $work/installed)"
configure /dev/facewire-eye
for port in /dev/ttyS1 /dev/facewire-head; do
    printf '[[link]]\nkind = "serial"\ndevice = "%s"\n' $port >>$work/facewire.toml
done
install -m 644 $work/facewire.toml $configuration
: >$work/refused
start_decoder

# The cameras' driver, too, is loaded after the start.
for module in videobuf2_vmalloc videobuf2_dma_contig videobuf2_memops videobuf2_v4l2 videobuf2_common videodev; do
    ! grep -q "^$module " /proc/modules || rmmod $module
done
! grep -q video4linux /proc/devices || fail 'the driver of cameras is loaded already'
systemctl start facewire || fail "not started: $(systemctl status facewire)"
await told 1 'no camera: no camera is called /dev/facewire-eye'
# In its sandbox, too, the service can read the files by which it recognises boards.
await told 1 'board generic, because'
told 1 "$(cat /sys/class/dmi/id/product_name)" || fail 'the board is not named'
pid=$(property MainPID)
# systemd takes dynamic users from 61184 to 65519.
user=$(property UID)
[ "$user" -ge 61184 ] || fail "it runs as user $user"
uvc-camera plug $work/demo.avi 2
await told 1 'camera opened: UVC Camera'
await seen live
usb-acm plug
await told 1 'link opened: /dev/facewire-head'
logged 1 'link opened: /dev/ttyS1' || fail 'the UART was not opened'
for device in /dev/video /dev/ttyS1 /dev/ttyACM; do
    opens "$pid" $device || fail "it has no $device open: $(ls -l "/proc/$pid/fd")"
done
[ "$(stat --format %u "/proc/$pid")" = "$user" ] || fail 'the process has another user'
echo "as user $user: $(grep 'camera opened' $work/log), $(readlink /proc/"$pid"/fd/* | grep '^/dev/tty' | paste -sd ' ')"

kill -KILL "$pid"
await is_another "$pid"
await told 2 'camera opened: UVC Camera'
echo "killed, back as $(property StatusText)"

# A stopped process does not serve the watchdog.
pid=$(property MainPID)
kill -STOP "$pid"
await is_another "$pid"
await told 3 'camera opened: UVC Camera'
[ "$(property NRestarts)" = 2 ] || fail "started again $(property NRestarts) times instead of twice"
echo "stuck, back by the watchdog: $(journalctl --unit facewire --output cat | grep -i watchdog | tail -n 1)"

# If one thread alone is stuck, the others go on to the neutral face, and the watchdog is no longer served all the same. The
# unit gives a frame 10 s, so these times end well before, and frames that take some seconds are not taken for stuck.
settle() { systemctl stop facewire 2>$work/said && systemctl start facewire; }
sed 's/live_ms = .*/live_ms = 4000/; s/hold_ms = .*/hold_ms = 6000/; s/neutral_ms = .*/neutral_ms = 7000/' \
    $work/facewire.toml >$configuration
printf '[realtime]\nhot_cpu = 1\n' >>$configuration
settle || fail "not started: $(systemctl status facewire)"
# The decoder begins a new file.
kill $decoder
start_decoder
await seen live
# The unit alone lets the service choose a CPU, as boards with two kinds of cores do.
await told 1 'hot on CPU 1$'
pid=$(property MainPID)
perl freeze-thread "$pid" fw-hot /facewire >$work/frozen &
await is_another "$pid"
passed live hold decay/late neutral/late || fail "one thread stuck: $(cat $work/judged)"
await told 5 'camera opened: UVC Camera'
[ "$(property NRestarts)" = 1 ] || fail "started again $(property NRestarts) times instead of once"
echo "$(cat $work/frozen): hold, decay, neutral; back by the watchdog"
install -m 644 $work/facewire.toml $configuration
settle || fail "not started: $(systemctl status facewire)"

pid=$(property MainPID)
printf '[camera]\nfps = 0\n' >>$configuration
systemctl reload facewire
await told 1 'settings refused: the current ones stay'
[ "$(property MainPID)" = "$pid" ] || fail 'bad settings ended the running service'
systemctl restart facewire 2>$work/said && fail 'it started with bad settings'
# If systemd were going to start the unit again, the unit would be "activating" meanwhile, not "failed".
await is_refused
[ "$(property NRestarts)" = 0 ] || fail "bad settings: started again $(property NRestarts) times"
echo "bad settings: exit status $(property ExecMainStatus), not started again"

install -D -m 644 -t /etc/systemd/system/facewire.service.d systemd/facewire.service.d/realtime.conf
{
    cat $work/facewire.toml
    printf '[realtime]\nlock_memory = true\npriority = 20\nhot_cpu = 1\n'
} >$configuration
systemctl daemon-reload
systemctl restart facewire || fail "not started: $(systemctl status facewire)"
await told 7 'camera opened: UVC Camera'
systemctl kill --signal USR1 facewire
await told 1 'real time: '
for grant in 'memory locked' 'sender priority 21' 'hot priority 20' 'hot on CPU 1'; do
    grep -qE "real time: .*$grant(,|\$)" $work/log || fail "not granted: $grant"
done
grep -o 'real time: .*' $work/log | tail -n 1

# By serial line alone: no network at all, and a port that comes later.
install -m 644 -t /etc/systemd/system/facewire.service.d systemd/facewire.service.d/serial-only.conf
{
    sed '/^\[\[link/,$d' $work/facewire.toml
    printf '[[link]]\nkind = "serial"\ndevice = "/dev/facewire-head"\n'
} >$configuration
systemctl daemon-reload
before=$(grep -c 'link opened: /dev/facewire-head' $work/log)
stty -F /dev/ttyGS0 raw -echo
systemctl restart facewire || fail "not started: $(systemctl status facewire)"
await told $((before + 1)) 'link opened: /dev/facewire-head'
received=$(timeout $patience head -c 1000 /dev/ttyGS0 | wc -c)
[ "$received" = 1000 ] || fail "only $received bytes came by the serial line"
grep 'link opened' $work/log | tail -n 1

# The emulated machine may be slower than any board.
printf '[Service]\nTimeoutStopSec=2min\n' >/etc/systemd/system/facewire.service.d/patience.conf
systemctl daemon-reload
systemctl stop facewire
[ "$(property ExecMainStatus)" = 0 ] || fail "stopped with $(property ExecMainStatus)"
kill $decoder
[ ! -s $work/refused ] || fail "refused packets: $(head -n 3 $work/refused)"
