#!/bin/sh
# The installed udev rules mark a microcontroller board for ModemManager, leave another vendor's adapter unmarked, and
# give neither a name. A rule that names a board by its serial number names no other board.
. cases/lib.sh
install -m 644 systemd/99-facewire.rules /usr/lib/udev/rules.d/
echo 'SUBSYSTEM=="tty", ATTRS{idVendor}=="2341", ATTRS{serial}=="1234", SYMLINK+="facewire-head"' \
    >/etc/udev/rules.d/99-facewire-names.rules
udevadm control --reload

# plug VENDOR SERIAL: plugs in the board with other numbers
plug() {
    usb-acm plug
    usb-acm unplug
    await test ! -e /dev/ttyACM0
    echo "$1" >/sys/kernel/config/usb_gadget/acm/idVendor
    echo "$2" >/sys/kernel/config/usb_gadget/acm/strings/0x409/serialnumber
    usb-acm plug
    udevadm settle
}
marked() { udevadm info --query=property --name=/dev/ttyACM0 | grep -qx 'ID_MM_DEVICE_IGNORE=1'; }
# The names in /dev that begin with facewire.
names() { find /dev -name 'facewire*' | paste -sd ' '; }

plug 0x2341 1234
marked || fail 'ModemManager would probe an Arduino'
[ "$(names)" = /dev/facewire-head ] || fail "names of the board that has a name: $(names)"
usb-acm unplug
plug 0x2341 5678
marked || fail 'ModemManager would probe another Arduino'
[ -z "$(names)" ] || fail "names of another board: $(names)"
usb-acm unplug
plug 0x1d6b 1234
! marked || fail 'a device of another vendor is hidden from ModemManager'
[ -z "$(names)" ] || fail "names of a device of another vendor: $(names)"
