#!/bin/sh
# With every file system read-only but those in memory, as docs/read-only.md describes, the installed unit starts, takes a
# camera that comes later, sends packets, and is started again after it was killed.
. cases/lib.sh

property() { systemctl show --property "$1" --value facewire; }
is_another() { [ "$(property ActiveState)" = active ] && [ "$(property MainPID)" != "$1" ]; }
told() { journalctl --unit facewire --output cat >$work/log && logged "$@"; }

systemd/install --binary facewire --networks networks >$work/installed || fail "$(cat $work/installed)"
film_without_a_face $work/wall.avi
configure auto
install -m 644 $work/facewire.toml /etc/facewire/facewire.toml
: >$work/refused
start_decoder

# Its folder of profiles is made when it is started for the first time.
systemctl start facewire || fail "not started: $(systemctl status facewire)"
systemctl stop facewire

# The journal moves to /run, as with Storage=volatile.
journalctl --relinquish-var
mount -o remount,ro / || fail 'the root cannot be made read-only'
for folder in /etc /usr /var /var/tmp /var/lib; do
    ! touch $folder/written 2>/dev/null || fail "$folder is writable"
done

systemctl start facewire || fail "not started: $(systemctl status facewire)"
uvc-camera plug $work/wall.avi 2
await told 1 'camera opened: UVC Camera'
await passed neutral/no_face
pid=$(property MainPID)
kill -KILL "$pid"
await is_another "$pid"
await told 2 'camera opened: UVC Camera'
systemctl stop facewire
[ "$(property ExecMainStatus)" = 0 ] || fail "stopped with $(property ExecMainStatus)"
[ ! -s $work/refused ] || fail "refused packets: $(head -n 3 $work/refused)"
echo "root $(findmnt --noheadings --output OPTIONS / | cut -d , -f 1): $(grep -c 'camera opened' $work/log) cameras opened"
