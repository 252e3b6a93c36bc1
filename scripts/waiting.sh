# shellcheck shell=bash
# Functions for steps that may take minutes: they say what they are doing and what they wait for. The scripts that source this
# file define `say` and `fail`.

# Seconds between two lines about a step that is still running.
progress_s=${FACEWIRE_PROGRESS_S:-30}

# watched LOG WHAT COMMAND...: runs a command with its output in LOG. While it runs, says every progress_s seconds how long it has
# been running, and the last line of its output.
watched() {
    local log=$1 what=$2 begin=$SECONDS end line status='' code
    shift 2
    # A pipe reports the end of the command, with its status.
    exec {end}< <(
        status=0
        "$@" >"$log" 2>&1 || status=$?
        echo "$status"
    )
    while true; do
        code=0
        read -r -t "$progress_s" -u "$end" status || code=$?
        # A status above 128 means that the time ran out, which may happen at the moment at which the command has ended.
        if ((code <= 128)) || [[ -n $status ]]; then break; fi
        line=$(tail -n 1 "$log" | sed 's/^ *//')
        say "$what: for $((SECONDS - begin)) s now${line:+, at: $line}"
    done
    exec {end}<&-
    return "${status:-1}"
}

# with_progress WHAT COMMAND...: runs a command that takes minutes. At a terminal its output appears as it comes. Otherwise only
# the lines of `watched` appear and, if the command fails, the end of its output.
with_progress() {
    local what=$1 log status=0
    say "$what"
    shift
    if [[ -t 2 ]]; then
        ("$@") >&2
        return
    fi
    log=$(mktemp)
    watched "$log" "$what" "$@" || status=$?
    ((status == 0)) || tail -n 20 "$log" >&2
    rm -f "$log"
    return "$status"
}

# What apt prints, whether as an error or as a warning, when it reaches no server.
unreachable='Temporary failure resolving|Could not resolve|Something wicked happened resolving|[Cc]ould not connect'
unreachable+='|Unable to connect|Cannot initiate the connection|Connection (failed|refused|timed out)|Network is unreachable'
unreachable+='|response from proxy'
# Whether the last apt_get has found that apt reaches a server no more, and that it knows no such package.
is_offline='' lacks_lists=''

# apt_get ARGUMENT...: runs apt-get as root. While another package manager holds one of its locks, says so and tries again,
# because apt's DPkg::Lock::Timeout does not cover the locks of the package lists and of the downloads.
apt_get() {
    local become=() log status tries holder begin=$SECONDS said=$SECONDS
    # By itself, sudo passes no variables on.
    ((EUID == 0)) || become=(sudo "--preserve-env=http_proxy,https_proxy,no_proxy")
    log=$(mktemp)
    for ((tries = 0; tries < 120; tries++)); do
        status=0
        watched "$log" "apt-get $1" "${become[@]}" env LC_ALL=C apt-get --quiet=2 "$@" || status=$?
        holder=''
        ((status == 0)) || holder=$(grep -m 1 'Could not get lock\|is another process using it\|locked by another process' "$log") || true
        [[ -n $holder ]] || break
        if ((tries == 0)); then
            say "another package manager is at work: waiting for it (${holder#E: })"
        elif ((SECONDS - said >= ${progress_s%.*})); then
            say "waiting for the other package manager: for $((SECONDS - begin)) s now (${holder#E: })"
            said=$SECONDS
        fi
        sleep 5
    done
    is_offline='' lacks_lists=''
    ! grep -qE "$unreachable" "$log" || is_offline=yes
    ! grep -qE 'Unable to locate package|no installation candidate' "$log" || lacks_lists=yes
    [[ $status == 0 || -n $holder ]] || tail -n 5 "$log" >&2
    rm -f "$log"
    [[ -z $holder ]] || fail "another package manager has been at work for ten minutes (${holder#E: }): try again when it has ended"
    return "$status"
}

# apt_install PACKAGE...: installs Debian packages.
apt_install() {
    local was_offline command=(apt-get install --no-install-recommends --yes "$@")
    command -v apt-get >/dev/null || fail "missing, by their Debian names: $*"
    ((EUID == 0)) || command -v sudo >/dev/null || fail "missing: $*. As root: ${command[*]}"
    say "installing $*"
    apt_get update || say 'apt-get update failed; trying with the lists at hand'
    was_offline=$is_offline
    apt_get "${command[@]:1}" && return
    # One source that does not answer prevents nothing by itself.
    [[ -z $is_offline && ! ($was_offline && $lacks_lists) ]] || fail "could not install $*, because apt reaches no server: is this machine online? \
Behind a proxy, set http_proxy. Then try again, or by hand: ${command[*]}"
    fail "could not install $*: the lines above say why. By hand: ${command[*]}"
}
