# What the cases have in common: the service from the guest's memory, and what it sends. Sourced by sh in the guest.
# shellcheck shell=sh

set -eu
# The judge's status when too few frames gave a pose.
too_few=3
work=/run/case
service='' decoder=''

fail() {
    echo "$*" >&2
    [ ! -e $work/log ] || tail -n 20 $work/log >&2
    exit 1
}

# Reading the shared folder is slow; all that is used more than once comes into memory.
unpack() {
    mkdir $work
    cp -r facewire networks packet_decoder.py judge.py demo.avi demo-truth.csv $work
    export FACEWIRE_NETWORKS=$work/networks
}

# configure DEVICE [FORMAT]: inference takes ten times as long as on a board and is no reason for the failsafe here.
configure() {
    cat >$work/facewire.toml <<CONFIG
[camera]
device = "$1"
format = "${2:-auto}"
stall_timeout_ms = 5000
[failsafe]
live_ms = 2000
hold_ms = 3000
neutral_ms = 4000
[[link]]
address = "127.0.0.1:5252"
CONFIG
}

# await SECONDS COMMAND...
await() {
    deadline=$(($(date +%s) + $1))
    shift
    until "$@"; do
        [ "$(date +%s)" -lt $deadline ] || fail "waited in vain for: $*"
        sleep 0.2
    done
}

# logged COUNT TEXT: the log has so many lines with this text, or more
logged() { [ "$(grep -c -- "$2" $work/log)" -ge "$1" ]; }

listening() { ss -lun | grep -q :5252; }

start_service() {
    : >$work/log
    python3 $work/packet_decoder.py --seconds 3600 --csv $work/packets.csv 2>$work/refused &
    decoder=$!
    await 20 listening
    $work/facewire run --config $work/facewire.toml 2>$work/log &
    service=$!
    await 30 logged 1 'camera opened'
}

# It ends well, told to or not killed by a panic; every packet was valid.
stop_service() {
    kill -TERM $service
    status=0
    wait $service || status=$?
    [ $status = 0 ] || fail "facewire run ended with exit status $status"
    ! grep -q panic $work/log || fail 'facewire run panicked'
    sleep 0.5
    kill $decoder
    [ ! -s $work/refused ] || fail "refused packets: $(head -n 3 $work/refused)"
}

# passed STEP...: the packets so far went through these steps
passed() { python3 $work/judge.py passes $work/packets.csv "$@" 2>$work/judged; }

# seen STATE: a packet said so; quicker than the judge, for long waits
seen() { grep -q ",$1," $work/packets.csv; }

# counted NAME: this counter of the last status line
counted() { sed -n "s/.*stopped: .*\\b$1=\\([0-9]*\\).*/\\1/p" $work/log; }

# Frames that gave a pose so far.
captured() { cut -d , -f 2,6 $work/packets.csv | grep '^live' | sort -u | wc -l; }

# shown_at FPS: the service had the clip before its camera for a whole turn; the status is the judge's.
# After a quarter, 60 frames, it is known whether the machine keeps up.
shown_at() {
    play "$1"
    start_service
    sleep $((60 / $1 + 4))
    [ "$(captured)" -lt 36 ] || sleep $((180 / $1))
    stop_service
    stop_playing
    [ "$(counted damaged)" = 0 ] || fail "damaged frames: $(counted damaged)"
    status=0
    python3 $work/judge.py clip $work/packets.csv $work/demo-truth.csv "$1" || status=$?
    return $status
}

# show_clip: the face of the clip reaches the packets. A case says how to play FPS and stop_playing.
# A busy machine gets another try at half the rate, for a pose that came from too few frames says nothing.
show_clip() {
    for rate in 4 2 1; do
        status=0
        shown_at $rate || status=$?
        [ "$status" = $too_few ] || break
    done
    grep -o 'camera opened: .*' $work/log
    [ "$status" = 0 ] || fail 'the face is not the one of the clip'
}

# refuses STATUS DEVICE FORMAT PATTERN: `facewire check` ends with the status and says the sentence, once
refuses() {
    configure "$2" "$3"
    status=0
    $work/facewire check --config $work/facewire.toml >$work/checked 2>$work/log || status=$?
    [ $status = "$1" ] || fail "camera $2, format $3: exit status $status instead of $1"
    [ "$(wc -l <$work/log)" = 1 ] || fail "camera $2, format $3: not one sentence"
    grep -qE "$4" $work/log || fail "camera $2, format $3: other words than $4"
    cat $work/log
}

unpack
