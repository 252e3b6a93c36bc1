# shellcheck shell=bash
# Downloads packages of Debian for another architecture and unpacks them without installing them. cross/setup and
# cross/count-tflite source this file after cross/common.sh.

# Prints the mirror from which this PC gets its own packages.
own_mirror() {
    # shellcheck disable=SC2016
    apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2>/dev/null | sed -n 's|/debian/$||p' | head -n 1 || true
}

mirror=${DEBIAN_MIRROR:-$(own_mirror)}
# shellcheck disable=SC2034 # The scripts that source this file use it.
offline_hint='is this machine online? Behind a proxy, set http_proxy; with a mirror, DEBIAN_MIRROR.'

# apt_for ARCHITECTURE FOLDER SUITE...: downloads the package lists of an architecture into FOLDER, and writes
# FOLDER/apt.conf, with which apt uses these lists. It clears the hooks that run after an update, because they would work
# on the lists of this PC.
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

# newest FOLDER PACKAGE: prints the newest version of a package in the lists that apt_for has downloaded into FOLDER.
newest() { apt-cache --config-file="$1/apt.conf" --no-all-versions show "$2" 2>/dev/null | sed -n 's/^Version: //p' || true; }

# unpack FOLDER TO PACKAGE...: downloads packages with FOLDER/apt.conf and unpacks them into TO.
unpack() {
    local folder=$1 to=$2 package
    shift 2
    (cd "$folder/archives" && apt-get --quiet=2 --config-file="$folder/apt.conf" download "$@") ||
        fail "could not download $*: $offline_hint"
    for package in "$folder"/archives/*.deb; do
        dpkg-deb --extract "$package" "$to"
    done
}
