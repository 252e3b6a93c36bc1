#!/bin/sh
# Removing the package stops the service, and keeps settings and profiles. Purging it leaves no file behind that was not
# there before it was installed, and systemd knows no failed unit, even if the service had failed.
. cases/lib.sh
. cases/package.sh

# systemd makes this folder for the first service with a state and a dynamic user.
[ -d /var/lib/private ] || mkdir -m 700 /var/lib/private
files >$work/before
install_package facewire.deb
plug_in
systemctl enable --now facewire 2>$work/said || fail "$(cat $work/said)"
await told 1 'camera opened'
echo wearer >/var/lib/facewire/profile
echo '# mine' >>/etc/facewire/facewire.toml

dpkg --remove facewire >$work/dpkg 2>&1 || fail "$(cat $work/dpkg)"
! systemctl is-active --quiet facewire || fail 'it still runs after its removal'
for file in /etc/facewire/facewire.toml /var/lib/facewire/profile; do
    [ -s $file ] || fail "the removal has not kept $file"
done
[ ! -e /usr/bin/facewire ] || fail 'the program is still there'

# Installed again, it starts as before; bad settings then make it fail for good.
install_package facewire.deb
printf '[camera]\nfps = 0\n' >/etc/facewire/facewire.toml
systemctl restart facewire 2>$work/said && fail 'it started with bad settings'
[ "$(systemctl is-failed facewire)" = failed ] || fail "with bad settings it is $(systemctl is-failed facewire)"
dpkg --purge facewire >$work/dpkg 2>&1 || fail "$(cat $work/dpkg)"
files >$work/after
diff $work/before $work/after >$work/left || fail "the purge has left or taken: $(cat $work/left)"
[ -z "$(systemctl list-units --all --no-legend 'facewire*')" ] || fail "$(systemctl list-units --all 'facewire*')"
[ -z "$(systemctl --failed --no-legend)" ] || fail "$(systemctl --failed)"
! grep -q facewire /var/lib/dpkg/status || fail 'dpkg still knows the package'
echo "nothing left of $(dpkg-deb --contents facewire.deb | wc -l) files and folders"
