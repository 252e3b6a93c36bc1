#!/bin/sh
# A machine on which the package was just installed: a camera that shows the frame of the built-in clip that the host wants, a
# Maestro, and the console. At its second start, the machine has the files that it had at its end. Runs in the guest for
# tests/guest/console, which clicks; files in /host say how far each of them is.
set -eu
work=/run/case
mkdir $work
cp maestro.py $work

fail() {
    echo "$*" >&2
    exit 1
}

# await COMMAND...: waits until the command succeeds, for ten minutes
await() {
    tries=0
    until "$@"; do
        tries=$((tries + 1))
        [ $tries -lt 600 ] || fail "waited in vain for: $*"
        sleep 1
    done
}

if [ ! -e /host/kept.tar ]; then
    dpkg --install facewire.deb </dev/null >$work/dpkg 2>&1 || fail "$(cat $work/dpkg)"
    [ "$(systemctl is-enabled facewire-console)" = disabled ] || fail 'the console is enabled after the installation'
    # Frames take seconds under emulation.
    cat >>/etc/facewire/facewire.toml <<CONFIG

# The head in the hall.
[adaptation]
enabled = false
[failsafe]
live_ms = 5000
hold_ms = 10000
neutral_ms = 10500
CONFIG
fi

# Puts the frame before the camera that the host wants, once it wants another.
pose() { [ ! -e /host/pose.jpg ] || { cp /host/pose.jpg $work/next.jpg && mv $work/next.jpg $work/pose.jpg && rm /host/pose.jpg; }; }
pose
feed-video $work/pose.jpg 2
usb-acm plug
usb-acm unplug
echo 0x1ffb >/sys/kernel/config/usb_gadget/acm/idVendor
echo 0x008a >/sys/kernel/config/usb_gadget/acm/idProduct
echo 'Pololu Corporation' >/sys/kernel/config/usb_gadget/acm/strings/0x409/manufacturer
usb-acm plug
stty -F /dev/ttyGS0 raw -echo
: >$work/targets
python3 $work/maestro.py /dev/ttyGS0 $work/targets &

modprobe virtio_net
ip address add 10.0.2.15/24 dev eth0
ip link set eth0 up
[ -e /host/kept.tar ] || systemctl enable --now facewire-console
listening() { ss -ltn | grep -q :5252; }
await listening

main_pid() { systemctl show --property MainPID --value facewire; }
restarted() { [ "$(main_pid)" != 0 ] && [ "$(main_pid)" != "$killed" ]; }

# Shows the host what the servos are told.
show() { tail -n 400 $work/targets >/host/targets.new && mv /host/targets.new /host/targets; }
touch /host/ready
[ ! -e /host/kept.tar ] || touch /host/restarted
while [ ! -e /host/end ] && [ ! -e /host/restart ]; do
    show
    pose
    if [ -e /host/kill ]; then
        killed=$(main_pid)
        systemctl kill --signal KILL facewire
        await restarted
        rm /host/kill
    fi
    sleep 1
done
grep -q '^# The head in the hall.$' /etc/facewire/facewire.toml || fail 'a comment is gone'
cp /etc/facewire/facewire.toml /host/kept.toml
journalctl --unit facewire --unit facewire-console --unit 'facewire-helper@*' --output short >>/host/journal
! grep -i panic /host/journal || fail 'a program panicked'
if [ -e /host/restart ]; then
    systemctl stop facewire facewire-console
    # shellcheck disable=SC2046
    tar --create --file /host/kept.new --numeric-owner /etc /var \
        --no-recursion $(ls -d $(dpkg -L facewire) 2>/dev/null) 2>$work/tar || fail "$(cat $work/tar)"
    cp $work/pose.jpg /host
    rm /host/restart /host/targets
    mv /host/kept.new /host/kept.tar
fi
