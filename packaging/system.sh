# shellcheck shell=bash
# A small Debian in a folder: for this PC, or for ARM by emulation. packaging/roots, packaging/try and python/try source this file
# after cross/common.sh.

# shellcheck source=cross/debian.sh
source "$root/cross/debian.sh"

registered=''

# describe_system amd64|arm64|armhf: sets the names of the architecture, of its emulator and of the processor to emulate.
describe_system() {
    case $1 in
    amd64) debian=amd64 cpu='' ;;
    arm64) describe aarch64 && emulator=qemu-aarch64-static cpu=cortex-a72 ;;
    armhf) describe armv7 && emulator=qemu-arm-static cpu=cortex-a15 ;;
    esac
}

# Makes the kernel run programs of the architecture by qemu, unless this PC does so already.
emulate() {
    local rules=/proc/sys/fs/binfmt_misc name=facewire-$emulator magic
    # The first 20 bytes of a program: an ELF file of this class (1 is 32 bits, 2 is 64), for this machine.
    case $debian in
    arm64) magic='\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00' ;;
    armhf) magic='\x7fELF\x01\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\x28\x00' ;;
    esac
    # Another run may mount it at the same moment.
    [[ -e $rules/register ]] || mount -t binfmt_misc binfmt_misc $rules 2>"$work/log" || [[ -e $rules/register ]] ||
        fail "the kernel cannot be told of an emulator: $(<"$work/log")"
    ! grep -qsx "interpreter .*$emulator" $rules/qemu-* $rules/facewire-* || return 0
    # Programs and libraries have the types 2 and 3, so one bit is masked. F keeps the emulator open inside of a chroot.
    printf '%s' ":$name:M::$magic:\\xff\\xff\\xff\\xff\\xff\\xff\\xff\\x00\\xff\\xff\\xff\\xff\\xff\\xff\\xff\\xff\\xfe\\xff\\xff\\xff:$(command -v "$emulator"):F" \
        >$rules/register
    registered=$rules/$name
}

# make_system FILE PACKAGES SUITE: makes the small Debian once.
make_system() {
    local system=$1
    [[ ! -e $system ]] || return 0
    say "making a Debian $3 for $debian (some minutes)"
    mkdir -p "$(dirname "$system")"
    # The mounts of mmdebstrap end with the mount namespace, even if it is killed.
    unshare --mount mmdebstrap --quiet --architectures="$debian" --variant=essential \
        --aptopt='Acquire::Languages "none"' ${2:+"--include=$2"} \
        "$3" "${system%.tar}.new.tar" \
        "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $mirror/debian $3 main" >"$work/log" 2>&1 || {
        tail -n 20 "$work/log" >&2
        fail "could not make a Debian for $debian: $offline_hint"
    }
    mv "${system%.tar}.new.tar" "$system"
}

# board COMMAND...: runs a command in the small Debian.
board() { chroot "$work/root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin QEMU_CPU="$cpu" "$@"; }

# enter_system PACKAGES [SUITE]: unpacks the small Debian, of version 12 if no suite is given, with these packages, separated by
# commas, into the folder root of $work.
enter_system() {
    local suite=${2:-bookworm} lock
    local system=$cache/systems/$suite-$debian${1:+-${1//,/-}}.tar
    # One run at a time for each architecture: the emulator is one for the whole machine.
    mkdir -p "$cache"
    exec {lock}>"$cache/emulation-$debian.lock"
    flock "$lock"
    [[ $debian == amd64 ]] || emulate
    make_system "$system" "$1" "$suite"
    mkdir "$work/root"
    tar --extract --file "$system" --directory "$work/root"
}

# Removes what enter_system made.
leave_system() {
    [[ -z $registered ]] || echo -1 >"$registered" || true
    rm -rf "$work"
}
