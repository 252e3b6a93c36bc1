#!/bin/sh
# An upgrade from an older package, whose default settings were others, asks nothing. It keeps changed settings and the
# profile of a wearer, and restarts the service if it runs. It starts no service that was stopped.
. cases/lib.sh
. cases/package.sh
profile=/var/lib/facewire/profile

install_package older.deb
[ "$(dpkg-query --show --showformat '${Version}' facewire)" = 0.0.1-1 ] || fail 'the older package is not installed'
cat >/etc/facewire/facewire.toml <<SETTINGS
[camera]
device = "/dev/video42"
[[link]]
address = "127.0.0.1:5252"
SETTINGS
cp /etc/facewire/facewire.toml $work/settings
systemctl enable --now facewire 2>$work/said || fail "$(cat $work/said)"
await told 1 'no camera is called /dev/video42'
echo wearer >$profile
pid=$(property MainPID)

install_package facewire.deb
[ "$(property ActiveState)" = active ] || fail "after the upgrade it is $(property ActiveState)"
[ "$(property MainPID)" != "$pid" ] || fail 'the upgrade has not restarted the service'
[ "$(readlink /proc/"$(property MainPID)"/exe)" = /usr/bin/facewire ] || fail 'the service is not the new program'
cmp /etc/facewire/facewire.toml $work/settings || fail 'the upgrade has changed the settings'
[ "$(cat $profile)" = wearer ] || fail 'the upgrade has lost the profile of the wearer'
[ "$(systemctl is-enabled facewire)" = enabled ] || fail 'the upgrade has disabled the service'
await told 2 'no camera is called /dev/video42'
echo "$(dpkg-query --show facewire): settings and profile kept, another process"

systemctl stop facewire
dpkg --install --force-downgrade older.deb </dev/null >$work/dpkg 2>&1 || fail "$(cat $work/dpkg)"
install_package facewire.deb
[ "$(property ActiveState)" = inactive ] || fail 'the upgrade has started a service that was stopped'
cmp /etc/facewire/facewire.toml $work/settings || fail 'the second upgrade has changed the settings'
