#!/bin/sh
# systemd's ExecStopPost= takes the pulses from a PCA9685 and the torque from bus servos after the service was killed, in its
# sandbox and as its user.
. cases/lib.sh
plug_in_pca9685
usb-acm plug
stty -F /dev/ttyGS0 raw -echo
cat /dev/ttyGS0 >$work/line &

configure /dev/video9
cat >>$work/facewire.toml <<CONFIG
[[link]]
kind = "pca9685"
bus = $bus
[[link.channel]]
channel = 1
sources = { jawOpen = 1.0 }
neutral = 0.5
[[link]]
kind = "bus-servo"
device = "/dev/ttyACM0"
family = "feetech-sts"
[[link.channel]]
channel = 7
sources = { jawOpen = 1.0 }
position_at_0 = 1000
position_at_1 = 2000
CONFIG
systemd/install --binary facewire --networks networks >$work/installed || fail "$(cat $work/installed)"
install -m 644 $work/facewire.toml /etc/facewire/facewire.toml
# Restart= would give the servos their places again at once.
install -D -m 644 systemd/facewire.service.d/i2c.conf /etc/systemd/system/facewire.service.d/i2c.conf
printf '[Service]\nRestart=no\n' >/etc/systemd/system/facewire.service.d/stay.conf
systemctl daemon-reload
groupadd --force --system i2c
chgrp i2c "/dev/i2c-$bus" && chmod 660 "/dev/i2c-$bus"

systemctl start facewire || fail "not started: $(systemctl status facewire)"
await has 0x0d 0x01
# A question to servo 7, which nobody answers.
asked() { od -An -v -tx1 $work/line | tr -d ' \n' | grep -q 'ffff070402'; }
await asked
systemctl kill --signal KILL facewire
inactive() { [ "$(systemctl show --property ActiveState --value facewire)" = failed ]; }
await inactive
has 0x0d 0x10 || fail "channel 1 still has pulses: $(register 0x0d); $(journalctl --unit facewire --output cat | tail -n 5)"
# The torque of servo 7 is written as 0, and nothing comes after it.
last_is_torque_off() { tail -c 10 $work/line | od -An -v -tx1 | tr -d ' \n' | grep -q '^fffffe06832801070048$'; }
await last_is_torque_off
journalctl --unit facewire --output cat | grep ': released'
