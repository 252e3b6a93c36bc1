#!/bin/sh
# A PCA9685 on an I2C bus of the kernel's i2c-stub: the service sets it up, gives its channels their pulses, sets it up again
# after its power failed, goes on from the pulses of a service that has crashed, and tells once that another chip does not
# answer. `facewire servo` moves a channel by keys, but not while the service has the chip.
. cases/lib.sh
plug_in_pca9685

# The registers after power-on: the chip sleeps, and its prescaler is that of 200 Hz.
power_on() {
    i2cset -y "$bus" 0x40 0x00 0x11
    i2cset -y "$bus" 0x40 0xfe 0x1e
}

power_on
i2cset -y "$bus" 0x40 0x05 0x5a
i2cset -y "$bus" 0x40 0x16 0xa5
configure /dev/video9
cat >>$work/facewire.toml <<CONFIG
[[link]]
kind = "pca9685"
bus = $bus
[[link.channel]]
channel = 1
sources = { jawOpen = 1.0 }
neutral = 0.5
[[link.channel]]
channel = 3
sources = { eyeBlinkLeft = 1.0 }
loss = "release"
[[link]]
kind = "pca9685"
bus = $bus
address = 0x41
[[link.channel]]
channel = 0
sources = { jawOpen = 1.0 }
CONFIG
: >$work/log
$work/facewire run --config $work/facewire.toml 2>$work/log &
service=$!
await logged 1 "link opened: I2C bus $bus, address 0x40"

# 25 MHz / 4096 / 50 Hz is 122, and the prescaler is one less, 0x79. 1500 microseconds are 307 (0x133) steps of 4.88.
await has 0x0c 0x33
has 0x0d 0x01 || fail "1500 us: $(register 0x0d)"
has 0xfe 0x79 || fail "prescaler $(register 0xfe)"
await has 0x15 0x10
# Channel 2 lies between them and gets no pulses. Registers that the service does not use keep their values.
has 0x11 0x10 || fail "channel 2: $(register 0x11)"
has 0x05 0x5a || fail "register 5: $(register 0x05)"
has 0x16 0xa5 || fail "channel 4: $(register 0x16)"

# The service is stopped meanwhile, so that it does not check the chip when only one of the two registers has changed.
kill -STOP $service
power_on
kill -CONT $service
await logged 1 'the chip lost its power'
await has 0xfe 0x79
[ $(($(register 0x00) & 0x10)) = 0 ] || fail 'the chip sleeps'
await has 0x0c 0x33

await logged 1 'address 0x41: no chip answers'

# servo: runs `facewire servo` in a terminal, whose keys come from standard input and whose screen goes to a file
servo() {
    timeout 120 socat "EXEC:$work/facewire servo --channel 1 --pca9685 $bus,pty,stderr,setsid" -,ignoreeof >$work/screen 2>&1
}
# The terminal may lose the last words of a program that ends at once, so it is asked until they come.
is_refused() {
    servo </dev/null || true
    grep -q 'another program moves servos there' $work/screen
}
await is_refused
kill -TERM $service
status=0
wait $service || status=$?
[ $status = 0 ] || fail "facewire run ended with exit status $status"
[ "$(grep -c '0x41: no chip answers' $work/log)" = 1 ] || fail 'the missing chip was told more than once'
[ "$(grep -c 'lost its power' $work/log)" = 1 ] || fail 'the power was told more than once'
! grep -q panic $work/log || fail 'facewire run panicked'
for register in 0x0d 0x15; do
    has $register 0x10 || fail "after the end, register $register is $(register $register), so that a channel has pulses"
done

mkfifo $work/keys
: >$work/screen
servo <$work/keys &
moved=$!
exec 9>$work/keys
await grep -q 'no pulses' $work/screen
printf '\033[C' >&9
await grep -q '1500 us   0' $work/screen
# The key up moves by five steps of 10 microseconds: 1550 microseconds are 318 (0x13e) steps of the chip.
printf '\033[A' >&9
await has 0x0c 0x3e
printf q >&9
await has 0x0d 0x10
exec 9>&-
wait $moved || true
grep -q '\[\[link.channel\]\]' $work/screen || fail 'no lines for the settings'

# A service that crashed has left 2000 microseconds, 410 steps. At 0.05 a second the servo goes by 10 steps a second from there.
i2cset -y "$bus" 0x40 0x0c 0x9a
i2cset -y "$bus" 0x40 0x0d 0x01
sed -i 's/^neutral = 0.5$/&\nspeed_per_s = 0.05/' $work/facewire.toml
: >$work/log
$work/facewire run --config $work/facewire.toml 2>$work/log &
service=$!
moved() { ! has 0x0c 0x9a; }
await moved
steps=$(($(register 0x0d) * 256 + $(register 0x0c)))
case $steps in 36[1-9] | 3[789][0-9] | 40[0-9]) ;; *) fail "after a crash, channel 1 went from 410 to $steps steps at once" ;; esac
kill -TERM $service
wait $service || true
echo "registers of 4 channels, power-on and a missing chip by i2c-stub on bus $bus"
