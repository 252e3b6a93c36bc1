#!/bin/sh
# What the console's helper runs has each directive with which the unit of the service and its drop-ins confine the service, as
# systemd has taken it. Within them it does its work: it finds camera, serial port and I2C bus, and takes a picture.
. cases/lib.sh

systemd/install --binary facewire --networks networks >$work/installed || fail "$(cat $work/installed)"
systemd-sysusers "$PWD"/systemd/facewire-console.sysusers
# The emulated machine may be slower than any board.
sed -i 's/RuntimeMaxSec=[0-9]*/RuntimeMaxSec=600/' systemd/facewire-helper systemd/facewire-helper@.service
install -D -m 755 -t /usr/lib/facewire systemd/facewire-helper
install -m 644 -t /usr/lib/systemd/system systemd/facewire-helper.socket systemd/facewire-helper@.service
for drop_in in i2c realtime; do
    install -D -m 644 -t /etc/systemd/system/facewire.service.d systemd/facewire.service.d/$drop_in.conf
done
systemctl daemon-reload
film_without_a_face $work/wall.avi
uvc-camera plug $work/wall.avi 2
usb-acm plug
plug_in_pca9685
configure auto
install -m 644 $work/facewire.toml /etc/facewire/facewire.toml
systemctl start facewire-helper.socket

# The program waits until its unit has been read.
mv /usr/bin/facewire /usr/bin/facewire-that-waits
cat >/usr/bin/facewire <<'PROGRAM'
#!/bin/sh
while [ ! -e /etc/facewire/begin ]; do sleep 0.2; done
exec /usr/bin/facewire-that-waits "$@"
PROGRAM
chmod 755 /usr/bin/facewire

runs() {
    unit=$(systemctl list-units --plain --no-legend --state=running 'run-*.service' | cut -d ' ' -f 1)
    [ -n "$unit" ]
}
# properties UNIT: prints the directives of the service as this unit has them, each with its words in order
properties() {
    for name in $names; do
        echo "$name: $(systemctl show --property "$name" --value "$1" | tr ' ' '\n' | sort | paste -sd ' ')"
    done
}
names=$(systemctl cat facewire.service | sed -nE 's/^([A-Za-z]+)=.*/\1/p' | sort -u |
    grep -vE '^(Description|Documentation|Wants|After|StartLimit.*|WantedBy|Type|Exec.*|Restart.*|Watchdog.*|RuntimeDirectory.*)$')
properties facewire.service >$work/service
for request in devices check; do
    echo $request | socat -t $patience - UNIX-CONNECT:/run/facewire-helper >$work/$request &
    client=$!
    await runs
    properties "$unit" >$work/command
    diff $work/service $work/command || fail "$request is confined otherwise"
    touch /etc/facewire/begin
    wait $client
    rm /etc/facewire/begin
done
echo "$(wc -l <$work/command) directives are those of the service"
for device in /dev/video /dev/ttyACM0 i2c_buses; do
    grep -q $device $work/devices || fail "no $device: $(cat $work/devices)"
done
cat $work/check
