# What the cases about the package share. Sourced by sh in the guest, after lib.sh.
# shellcheck shell=sh disable=SC2154

[ -e facewire.deb ] || fail 'no package: run scripts/package'
# The guest leaves documentation out of every package but this one.
rm -f /etc/dpkg/dpkg.cfg.d/*

property() { systemctl show --property "$1" --value facewire; }
told() { journalctl --unit facewire --output cat >"$work"/log && logged "$@"; }

# dpkg has no terminal: it fails instead of asking.
install_package() { dpkg --install "$1" </dev/null >"$work"/dpkg 2>&1 || fail "$(cat "$work/dpkg")"; }

# Plugs in the camera and the board, in this order.
plug_in() {
    uvc-camera plug "$work"/wall.avi 2
    usb-acm plug
    stty -F /dev/ttyGS0 raw -echo
}

# Every file and folder, except those that dpkg and systemd keep for themselves.
files() {
    find / -xdev \( -path /proc -o -path /sys -o -path /dev -o -path /run -o -path /tmp -o -path /host -o -path /ctl \
        -o -path /var/log -o -path /var/cache -o -path /var/lib/dpkg/triggers -o -path '/var/lib/dpkg/*-old' \
        -o -name __pycache__ \) -prune -o -print | sort
}

film_without_a_face "$work"/wall.avi
