# shellcheck shell=bash
# Names, folders and functions that the scripts in cross/ share. They source this file.

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cache=${XDG_CACHE_HOME:-$HOME/.cache}/facewire
target_folder=$(realpath --canonicalize-missing -- "${CARGO_TARGET_DIR:-$root/target}")
program=${0##*/}
# shellcheck source=scripts/waiting.sh
source "$root/scripts/waiting.sh"
# The programs of the service, and all that boards get.
# shellcheck disable=SC2034 # The scripts that source this file use them.
of_service=(facewire facewire-tools) shipped=(facewire facewire-tools facewire-console facewire-bridge)

say() { printf '%s: %s\n' "$program" "$*"; }

fail() {
    printf '%s: %s\n' "$program" "$*" >&2
    exit 1
}

# Prints the version in Cargo.toml.
version_in_cargo() { sed -n 's/^version = "\(.*\)"/\1/p' "$root/Cargo.toml" | head -n 1; }

# Prints the version of the last commit, whose time SOURCE_DATE_EPOCH gives: that of Cargo.toml for a commit with the tag
# vVERSION, and without git; otherwise VERSION~TIME.COMMIT, which is older than VERSION, and +modified for changed files.
version_of_commit() {
    local version commit
    version=$(version_in_cargo)
    commit=$(git -C "$root" rev-parse --short=8 HEAD 2>/dev/null) || commit=''
    if [[ -n $commit && -z $(git -C "$root" tag --points-at HEAD --list "v$version") ]]; then
        version+="~$(date --utc --date="@$SOURCE_DATE_EPOCH" +%Y%m%d%H%M%S).$commit"
        [[ -z $(git -C "$root" status --porcelain --untracked-files=no) ]] || version+=+modified
    fi
    echo "$version"
}

# describe ARCHITECTURE: sets the names that Rust, GNU and Debian use for an architecture, and the folders of its files.
# Fails if facewire is not built for it.
describe() {
    architecture=$1
    case $architecture in
    aarch64) triple=aarch64-unknown-linux-gnu gnu=aarch64-linux-gnu debian=arm64 ;;
    armv7) triple=armv7-unknown-linux-gnueabihf gnu=arm-linux-gnueabihf debian=armhf ;;
    *) return 1 ;;
    esac
    # shellcheck disable=SC2034 # The scripts that source this file use them.
    triple_in_variables=$(tr 'a-z-' 'A-Z_' <<<"$triple") gnu_linker=$gnu-gcc toolchain=$cache/cross/$debian board_folder=$target_folder/boards/$architecture
}

# Succeeds if the compiler that cargo would use (from rustup or the distribution) has the target's standard library.
own_compiler_has_target() {
    local libraries
    libraries=$(cd "$root" && "${RUSTC:-rustc}" --print target-libdir --target "$triple" 2>/dev/null) &&
        compgen -G "$libraries/libstd-*.rlib" >/dev/null
}

# newest_wheel x86_64|aarch64|armv7: prints the path of the newest Python wheel.
newest_wheel() {
    local wheel
    wheel=$(find "$target_folder/wheels" -name "facewire-*_$1*.whl" -printf '%T@ %p\n' 2>/dev/null | sort -n | tail -n 1 | cut -d ' ' -f 2-) || true
    [[ -n $wheel ]] || fail "there is no wheel for $1 in $target_folder/wheels: scripts/wheel $1"
    echo "$wheel"
}

# leave_folders_out: makes cargo leave the names of this PC's folders out of the programs that it builds, so that builds in
# different folders give the same bytes. The flag does not name the checkout, to whose files cargo gives rustc relative paths:
# other people's crates are compiled alike for all checkouts of a machine.
leave_folders_out() { export CARGO_ENCODED_RUSTFLAGS="--remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=/cargo"; }

# Makes cargo build for the architecture, always with the same flags, so that each dependency is compiled once.
use_target_compiler() {
    leave_folders_out
    export "CARGO_TARGET_${triple_in_variables}_LINKER=$gnu_linker"
    own_compiler_has_target || export RUSTC=$toolchain/rustc
}

# cargo_build OPTION...: builds what these options of cargo select. The time that C compilers take for that of the source is
# always the same: with another one, cargo would compile crates with C code, and all that use them, again.
cargo_build() { (cd "$root" && SOURCE_DATE_EPOCH=0 CARGO_TARGET_DIR=$target_folder cargo build --locked "$@"); }

# build_service FEATURES OPTION...: builds facewire and its tools, with these options of cargo. FEATURES is another one, such as
# --no-default-features, or empty.
build_service() { cargo_build --package facewire --package facewire-tools --bins ${1:+"$1"} "${@:2}"; }

# build_programs FEATURES OPTION...: builds the programs that boards get, as build_service does. facewire-console and
# facewire-bridge have their own runs of cargo, because one run for all would give a shared dependency the features that any of
# them needs.
build_programs() {
    build_service "$@" && cargo_build --package facewire-console "${@:2}" && cargo_build --package facewire-bridge "${@:2}"
}

# make_sysroot FOLDER: writes the files that an emulated program sees in place of those of this PC: the C library of the
# target, and a /proc/cpuinfo of a Cortex-A72, because ONNX Runtime for aarch64 fails when it reads that of an x86-64 PC.
make_sysroot() {
    local core
    mkdir -p "$1/proc"
    ln -s "/usr/$gnu/lib" "$1/lib"
    for core in 0 1 2 3; do
        cat <<END_OF_CORE
processor	: $core
BogoMIPS	: 108.00
Features	: fp asimd evtstrm crc32 cpuid
CPU implementer	: 0x41
CPU architecture: 8
CPU variant	: 0x0
CPU part	: 0xd08
CPU revision	: 3

END_OF_CORE
    done >"$1/proc/cpuinfo"
}
