# shellcheck shell=bash
# Downloads packages of Debian for another architecture and unpacks them without installing them. cross/setup and
# cross/count-tflite source this file after cross/common.sh.

# Prints the mirror that this PC's own packages come from. It is used unless DEBIAN_MIRROR names another.
own_mirror() {
    # shellcheck disable=SC2016
    apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2>/dev/null | sed -n 's|/debian/$||p' | head -n 1 || true
}

mirror=${DEBIAN_MIRROR:-$(own_mirror)}
# shellcheck disable=SC2034 # The scripts that source this file use it.
offline_hint='is this machine online? Behind a proxy, set http_proxy; with a mirror, DEBIAN_MIRROR.'

# apt_for ARCHITECTURE FOLDER SUITE...: writes FOLDER/apt.conf, with which apt uses package lists of its own. The hooks
# that run after an update are cleared, because they work on the host's lists.
apt_for() {
    local of=$1 folder=$2 suite part
    shift 2
    mkdir -p "$folder/lists/partial" "$folder/archives/partial"
    for suite in "$@"; do
        part=debian
        [[ $suite != *-security ]] || part='debian-security'
        echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $mirror/$part $suite main"
    done >"$folder/sources.list"
    : >"$folder/status"
    cat >"$folder/apt.conf" <<END_OF_CONFIGURATION
APT::Architecture "$of";
#clear APT::Architectures;
APT::Architectures { "$of"; };
APT::Sandbox::User "root";
APT::Update::Error-Mode "any";
#clear APT::Update::Post-Invoke;
#clear APT::Update::Post-Invoke-Success;
Dir::State::Lists "$folder/lists";
Dir::State::status "$folder/status";
Dir::Cache::archives "$folder/archives";
Dir::Cache::pkgcache "";
Dir::Cache::srcpkgcache "";
Dir::Etc::SourceList "$folder/sources.list";
Dir::Etc::SourceParts "-";
END_OF_CONFIGURATION
    apt-get --quiet=2 --config-file="$folder/apt.conf" update ||
        fail "could not get Debian's list of packages for $of: $offline_hint"
}

# Prints the newest version of a package in the list of `apt_for`.
newest() { apt-cache --config-file="$1/apt.conf" --no-all-versions show "$2" 2>/dev/null | sed -n 's/^Version: //p' || true; }

# unpack FOLDER TO PACKAGE...: downloads packages by FOLDER/apt.conf and unpacks them into TO.
unpack() {
    local folder=$1 to=$2 package
    shift 2
    (cd "$folder/archives" && apt-get --quiet=2 --config-file="$folder/apt.conf" download "$@") ||
        fail "could not download $*: $offline_hint"
    for package in "$folder"/archives/*.deb; do
        dpkg-deb --extract "$package" "$to"
    done
}
