# What the cases share: the service, run from the guest's memory, and its packets. Sourced by sh in the guest.
# shellcheck shell=sh

set -eu
# Longest wait for a state, in seconds. On a busy machine the emulated service takes seconds for a frame.
patience=600
work=/run/case
# Frames of the built-in clip with eyes and mouth wide open and shut.
# shellcheck disable=SC2034 # The cases use it.
frames='8 20 24 48 92 100 104 220'
service='' decoder=''

fail() {
    echo "$*" >&2
    [ ! -e $work/log ] || tail -n 20 $work/log >&2
    exit 1
}

# Copies into memory what is used more than once, because reading the shared folder is slow.
unpack() {
    mkdir $work
    cp -r facewire facewire-tools networks facewire_packet.py packet_recorder.py judge.py demo.avi $work
    export FACEWIRE_NETWORKS=$work/networks
}

# configure DEVICE [FORMAT]: writes settings that allow for frames that take seconds, as they do under emulation. The
# service processes every frame it can: the cases choose the rate that it can follow.
configure() {
    cat >$work/facewire.toml <<CONFIG
[camera]
device = "$1"
format = "${2:-auto}"
stall_timeout_ms = 30000
[adaptation]
enabled = false
[failsafe]
live_ms = 5000
hold_ms = 10000
neutral_ms = 10500
[[link]]
address = "127.0.0.1:5252"
CONFIG
}

# plug_in_pca9685: puts a PCA9685 at address 0x40 of an I2C bus of the kernel's i2c-stub, whose number is then in $bus
plug_in_pca9685() {
    modprobe i2c-dev
    modprobe i2c-stub chip_addr=0x40
    bus=$(grep -l 'SMBus stub' /sys/class/i2c-dev/i2c-*/name | head -n 1 | sed 's/.*i2c-\([0-9]*\).*/\1/')
    await test -e "/dev/i2c-$bus"
}

# register NUMBER: prints what is in this register of the PCA9685
register() { i2cget -y "$bus" 0x40 "$1"; }

# has NUMBER VALUE: this register has this value
has() { [ "$(register "$1")" = "$2" ]; }

# film_without_a_face FILE: makes a Motion-JPEG film of a grey wall. Its brightness changes, because a camera that sends the same
# picture again and again counts as none. Frames without a face need the detector alone and change the packets' reason at once,
# so tests of cameras and ports do not wait for landmarks.
film_without_a_face() {
    ffmpeg -nostdin -v error -f lavfi -i "nullsrc=size=640x480:rate=30,geq=lum=120+2*N:cb=128:cr=128" -frames:v 8 \
        -pix_fmt yuvj422p -c:v mjpeg "$1"
}

# await COMMAND...: waits until the command succeeds
await() {
    deadline=$(($(date +%s) + patience))
    until "$@"; do
        [ "$(date +%s)" -lt $deadline ] || fail "waited in vain for: $*"
        sleep 0.2
    done
}

# logged COUNT TEXT: the log has this many lines with this text, or more
logged() { [ "$(grep -c -- "$2" $work/log)" -ge "$1" ]; }

listening() { ss -lun | grep -q :5252; }

start_decoder() {
    : >$work/packets.csv
    python3 $work/packet_recorder.py --seconds 3600 --csv $work/packets.csv 2>>$work/refused &
    decoder=$!
    await listening
}

start_service() {
    : >$work/log
    : >$work/refused
    start_decoder
    $work/facewire run --config $work/facewire.toml 2>$work/log &
    service=$!
    await logged 1 'camera opened'
}

# Stops the service, which must not have panicked, and checks that every packet was valid.
stop_service() {
    kill -TERM $service
    status=0
    wait $service || status=$?
    [ $status = 0 ] || fail "facewire run ended with exit status $status"
    ! grep -q panic $work/log || fail 'facewire run panicked'
    await passed neutral/stopping
    kill $decoder
    [ ! -s $work/refused ] || fail "refused packets: $(head -n 3 $work/refused)"
}

# passed STEP...: the packets so far went through these steps
passed() { python3 $work/judge.py passes $work/packets.csv "$@" 2>$work/judged; }

# seen STATE: a packet had this state; quicker than `passed`, for long waits
seen() { grep -q ",$1," $work/packets.csv; }

# counted NAME: this counter of the status line that the service wrote last
counted() { grep -E 'frames=[0-9]' $work/log | tail -n 1 | sed -n "s/.*\\b$1=\\([0-9]*\\).*/\\1/p"; }

# read_frames COUNT: the service has read this many frames
read_frames() {
    kill -USR1 "$service"
    [ "$(counted frames)" -ge "$1" ] 2>/dev/null
}

# show_clip CAMERA FRAME...: checks that the packets show the face of the built-in clip, with its own pose for each of these
# frames. show_clip.py shows a frame once the packets have the pose of the previous one, however long that takes.
show_clip() {
    cp receivers.py show_clip.py truth.csv $work
    : >$work/packets.csv
    camera=$1
    shift
    python3 $work/show_clip.py "$camera" $work/demo.avi $work/packets.csv $work/shown.csv "$@" &
    feeder=$!
    start_service
    while [ ! -e $work/shown.csv ] && kill -0 $feeder 2>/dev/null; do sleep 0.2; done
    [ -e $work/shown.csv ] || fail 'the frames were not shown'
    stop_service
    kill $feeder
    [ "$(counted damaged)" = 0 ] || fail "damaged frames: $(counted damaged)"
    grep -o 'camera opened: .*' $work/log
    python3 $work/judge.py clip $work/packets.csv $work/shown.csv $work/truth.csv || fail 'the face is not the face of the clip'
}

unpack
