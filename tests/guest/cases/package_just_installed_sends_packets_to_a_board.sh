#!/bin/sh
# Installing the package starts nothing. After that a camera and a board are plugged in and the unit is enabled: with the
# default settings, packets come by the serial line, and facewire-console shows them. No other serial port is written to.
. cases/lib.sh
. cases/package.sh
cp receivers.py board.py $work

install_package facewire.deb
[ "$(systemctl is-enabled facewire)" = disabled ] || fail "after the installation it is $(systemctl is-enabled facewire)"
[ "$(property ActiveState)" = inactive ] || fail "after the installation it is $(property ActiveState)"
facewire --version
for file in man/man1/facewire-run.1.gz man/man1/facewire-console.1.gz bash-completion/completions/facewire \
    doc/facewire/copyright facewire/defaults.toml; do
    [ -s /usr/share/$file ] || fail "no /usr/share/$file"
done
facewire defaults | cmp - /usr/share/facewire/defaults.toml || fail 'the defaults differ from those of the program'

plug_in
systemctl enable --now facewire 2>$work/said || fail "$(cat $work/said)"
python3 $work/board.py /dev/ttyGS0 'no face' || fail "$(journalctl --unit facewire --output cat | tail -n 20)"
told 1 'link opened: /dev/serial/by-id/usb-Arduino_8036_1234-if00 at 115200 baud'
grep 'link opened' $work/log
! readlink /proc/"$(property MainPID)"/fd/* | grep ttyS || fail 'it has opened a serial port that is no board'

# facewire-console, without any settings, shows what the service sends to this machine.
view=http://127.0.0.1:5252
shown() { busybox timeout 5 busybox wget -qO- $view/api/1/events | grep -q '"reason":"no face"'; }
facewire-console >$work/view 2>&1 &
await shown
busybox wget -qO- $view/ | grep -q '<title>facewire<' || fail "no page: $(cat $work/view)"

# Another maker's port is not taken, and the log names it.
usb-acm unplug
await told 1 'went away'
echo 0x1a86 >/sys/kernel/config/usb_gadget/acm/idVendor
usb-acm plug
await told 1 'waits for a microcontroller board.*give its path as link.device: /dev/serial/by-id/usb-'
! told 2 'link opened: /dev/serial' || fail 'it has opened an adapter of general use'
