#!/bin/sh
# The unit of facewire-bridge receives, and publishes to a broker and to ROS 2, from its sandbox. It comes back after it was
# killed, stays away while its settings are faulty, and leaves nothing once it is purged.
. cases/lib.sh
. cases/package.sh
ip address add 10.0.2.15/24 dev eth0
ip link set eth0 up
state() { systemctl show --property ActiveState --value facewire-bridge; }
told() { journalctl --unit facewire-bridge --output cat >$work/log && logged "$@"; }
is() { [ "$(state)" = "$1" ]; }

# Prints the name of the protocol in the first message to a broker, or to participants of DDS.
cat >$work/listen.py <<'PYTHON'
import socket, sys

if sys.argv[1] == "broker":
    print(socket.create_server(("127.0.0.1", 1883)).accept()[0].recv(100)[4:8].decode())
else:
    group = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    group.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    group.bind(("239.255.0.1", 7400))
    group.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.255.0.1") + socket.inet_aton("10.0.2.15"))
    print(group.recv(2000)[:4].decode())
PYTHON
hello() { python3 -c 'import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"hello", ("127.0.0.1", 5252))'; }
received() { hello && told "$1" 'damaged datagrams: .* from 127.0.0.1'; }

[ -d /var/lib/private ] || mkdir -m 700 /var/lib/private
files >$work/before
install_package bridge.deb
is inactive || fail "after the installation it is $(state)"
echo '[ros]' >>/etc/facewire-bridge/bridge.toml
python3 $work/listen.py broker >$work/broker &
python3 $work/listen.py ros >$work/ros &
systemctl enable --now facewire-bridge 2>$work/said || fail "$(cat $work/said)"
await grep -q '^MQTT' $work/broker
await grep -q '^RTPS' $work/ros
await received 1
systemctl kill --signal KILL facewire-bridge
await received 2

echo 'namespace = 1' >/etc/facewire-bridge/bridge.toml
systemctl restart facewire-bridge || true
await is failed
told 1 'bridge.toml: .*line 1' || fail 'the fault is not told'
[ "$(systemctl show --property ExecMainStatus --value facewire-bridge)" = 78 ] || fail 'not the status of faulty settings'
dpkg --purge facewire-bridge >$work/dpkg 2>&1 || fail "$(cat $work/dpkg)"
files >$work/after
diff $work/before $work/after >$work/left || fail "the purge has left or taken: $(cat $work/left)"
