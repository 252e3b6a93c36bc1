// Eyes, lids, brows, jaw and neck on a PCA9685 servo board that follow facewire over a serial line.
// SPDX-License-Identifier: MIT OR Apache-2.0
//
// For an Arduino Uno and other boards with 2 KB of memory; needs no library but Wire, which comes with the Arduino IDE.
// Copy facewire_packet.h to this folder. SDA and SCL go to the pins of these names (A4 and A5 of an Uno), OE to pin 7.
// Adjust the pulse widths to your servos, and try them before you attach the linkage.

#include <Wire.h>

#include "facewire_packet.h"

// Serial is the USB connector, on an Uno also pin 0. On boards with a second serial port, Serial1 is the RX pin.
#define LINE Serial

const unsigned long BAUD = 115200;
const uint8_t ADDRESS = 0x40;
// There are pulses only while this pin drives OE low. With a resistor of 1 kOhm from OE to VCC, they therefore end when
// the Arduino has no power. 255: OE is not wired.
const uint8_t OUTPUT_ENABLE_PIN = 7;
// The chip's own clock is a few percent off. If a pulse of 1500 us measures 1450 us, enter 25000 * 1500 / 1450.
const uint32_t OSCILLATOR_KHZ = 25000;
const uint8_t PRESCALE = 121; // 50 pulses a second
const uint32_t PULSE_MS = 20;
// Servos start one after another, because together they pull the supply down.
const uint32_t START_MS = 200;
// After this time without packets the servos get no pulses, so that they neither hum nor heat. 0 keeps the pulses.
const uint32_t RELEASE_MS = 10000;

// What moves a joint: a blendshape, or the head to one side. A head that is turned by 45 degrees counts as 1.
enum { NOTHING = 100, HEAD_TURNED_LEFT, HEAD_TURNED_RIGHT, HEAD_UP, HEAD_DOWN, HEAD_TILTED_LEFT, HEAD_TILTED_RIGHT };

struct Joint {
    uint8_t up, down; // what moves the joint to either side
    int down_us, neutral_us, up_us; // no pulse lies outside of the first and the last
    int travel_ms;    // shortest time from the first to the last
};

// The joints of channels 0, 1, 2 and so on.
const Joint joints[] = {
    {FACEWIRE_JAW_OPEN, NOTHING, 1000, 1000, 1600, 250},
    {FACEWIRE_EYE_BLINK_LEFT, FACEWIRE_EYE_WIDE_LEFT, 1900, 1800, 1200, 100},
    {FACEWIRE_EYE_BLINK_RIGHT, FACEWIRE_EYE_WIDE_RIGHT, 1100, 1200, 1800, 100},
    {FACEWIRE_EYE_LOOK_OUT_LEFT, FACEWIRE_EYE_LOOK_IN_LEFT, 1300, 1500, 1700, 100},
    {FACEWIRE_EYE_LOOK_IN_RIGHT, FACEWIRE_EYE_LOOK_OUT_RIGHT, 1300, 1500, 1700, 100},
    {FACEWIRE_EYE_LOOK_UP_LEFT, FACEWIRE_EYE_LOOK_DOWN_LEFT, 1350, 1500, 1650, 100},
    {FACEWIRE_BROW_INNER_UP, FACEWIRE_BROW_DOWN_LEFT, 1300, 1500, 1700, 150},
    {HEAD_TURNED_LEFT, HEAD_TURNED_RIGHT, 1000, 1500, 2000, 800},
    {HEAD_UP, HEAD_DOWN, 1200, 1500, 1800, 800},
};
const uint8_t JOINTS = sizeof joints / sizeof joints[0];

// Registers and bits of the PCA9685, from its data sheet.
const uint8_t MODE1 = 0x00, CHANNEL_0 = 0x06, ALL_CHANNELS = 0xFA, PRE_SCALE = 0xFE;
const uint8_t SLEEP = 0x10, AUTO_INCREMENT = 0x20, FULL_OFF = 0x10;
// Wire holds 32 bytes: the register and the 4 bytes of 7 channels.
const uint8_t CHANNELS_AT_ONCE = 7;

int pulses_us[JOINTS];
uint8_t started = 0;     // number of servos that get pulses
bool board_is_ready = false;
struct facewire_line line;
struct facewire_packet packet;
struct facewire_receiver receiver; // all zero at first, which is the neutral face
int16_t rotation[4];
uint32_t moved_ms = 0, started_ms = 0, heard_ms = 0, checked_ms = 0;

bool write_register(uint8_t address, uint8_t value) {
    Wire.beginTransmission(ADDRESS);
    Wire.write(address);
    Wire.write(value);
    return Wire.endTransmission() == 0;
}

// The servo board keeps its pulses when the Arduino restarts, and forgets its settings when its own power fails.
bool set_up_board() {
    started = 0;
    for (uint8_t i = 0; i < JOINTS; i++) pulses_us[i] = joints[i].neutral_us;
    bool is_ready = write_register(MODE1, SLEEP | AUTO_INCREMENT) && write_register(PRE_SCALE, PRESCALE) &&
                    write_register(ALL_CHANNELS + 3, FULL_OFF) && write_register(MODE1, AUTO_INCREMENT);
    if (OUTPUT_ENABLE_PIN != 255) digitalWrite(OUTPUT_ENABLE_PIN, is_ready ? LOW : HIGH);
    return is_ready;
}

bool is_set_up() {
    Wire.beginTransmission(ADDRESS);
    Wire.write(MODE1);
    if (Wire.endTransmission() != 0 || Wire.requestFrom(ADDRESS, (uint8_t)1) != 1) return false;
    return Wire.read() == AUTO_INCREMENT;
}

void setup() {
    if (OUTPUT_ENABLE_PIN != 255) {
        digitalWrite(OUTPUT_ENABLE_PIN, HIGH);
        pinMode(OUTPUT_ENABLE_PIN, OUTPUT);
    }
    LINE.begin(BAUD);
    Wire.begin();
    Wire.setClock(400000); // 9 channels take 1 ms of every 20, at 100 kHz 4 ms
#if defined(ARDUINO_ARCH_AVR) || defined(WIRE_HAS_TIMEOUT)
    Wire.setWireTimeout(3000, true); // without it, a bus that hangs stops this program; Arduino AVR Boards 1.8.3 or later
#endif
    board_is_ready = set_up_board();
}

// Takes what has come. The number of bytes is bounded, so that a line full of garbage does not keep the servos waiting.
void read_line() {
    for (uint8_t i = 0; i < 200 && LINE.available() > 0; i++) {
        if (facewire_feed(&line, (uint8_t)LINE.read(), &packet) == FACEWIRE_OK) {
            facewire_receive(&receiver, &packet, millis());
        }
    }
}

// Returns 0 to 65535 for a blendshape or a direction of the head. A component of the rotation is the sine of half the
// angle around its axis; for 45 degrees that is 0.38.
long amount(uint8_t source) {
    long sine;
    switch (source) {
    case NOTHING: return 0;
    case HEAD_TURNED_LEFT: sine = rotation[1]; break;
    case HEAD_TURNED_RIGHT: sine = -rotation[1]; break;
    case HEAD_UP: sine = -rotation[0]; break;
    case HEAD_DOWN: sine = rotation[0]; break;
    case HEAD_TILTED_LEFT: sine = -rotation[2]; break;
    case HEAD_TILTED_RIGHT: sine = rotation[2]; break;
    default: return facewire_shown(&receiver, source);
    }
    return constrain(sine * 100 / 38 * 2, 0L, FACEWIRE_COEFFICIENT_ONE);
}

void move(uint8_t i) {
    const Joint &joint = joints[i];
    long up_us = (joint.up_us - joint.neutral_us) * amount(joint.up) / FACEWIRE_COEFFICIENT_ONE;
    long down_us = (joint.down_us - joint.neutral_us) * amount(joint.down) / FACEWIRE_COEFFICIENT_ONE;
    long step_us = 1 + labs((long)joint.up_us - joint.down_us) * (long)PULSE_MS / joint.travel_ms;
    pulses_us[i] += (int)constrain(joint.neutral_us + up_us + down_us - pulses_us[i], -step_us, step_us);
}

// Sends the pulses of some channels in one transfer, so that they change together.
void send(uint8_t first, uint8_t end) {
    Wire.beginTransmission(ADDRESS);
    Wire.write((uint8_t)(CHANNEL_0 + 4 * first));
    for (uint8_t i = first; i < end; i++) {
        uint32_t counts = (uint32_t)pulses_us[i] * OSCILLATOR_KHZ / 1000 / (PRESCALE + 1);
        Wire.write((uint8_t)0);
        Wire.write((uint8_t)0);
        Wire.write((uint8_t)counts);
        Wire.write((uint8_t)(i < started ? counts >> 8 : FULL_OFF));
    }
    Wire.endTransmission(); // a failure shows in the next check of the board
}

void start_and_release(uint32_t now_ms) {
    if (receiver.receiving) {
        heard_ms = now_ms;
        if (started < JOINTS && now_ms - started_ms >= START_MS) {
            started++;
            started_ms = now_ms;
        }
    } else if (RELEASE_MS > 0 && now_ms - heard_ms >= RELEASE_MS) {
        started = 0;
    }
}

void loop() {
    read_line();
    uint32_t now_ms = millis();
    if (now_ms - moved_ms < PULSE_MS) return;
    moved_ms = now_ms;
    facewire_update(&receiver, now_ms);
    facewire_shown_rotation(&receiver, rotation);
    if (now_ms - checked_ms >= 1000) {
        checked_ms = now_ms;
        board_is_ready = (board_is_ready && is_set_up()) || set_up_board();
    }
    if (!board_is_ready) return;
    start_and_release(now_ms);
    for (uint8_t i = 0; i < started; i++) move(i);
    for (uint8_t first = 0; first < JOINTS; first += CHANNELS_AT_ONCE) {
        uint8_t end = first + CHANNELS_AT_ONCE < JOINTS ? first + CHANNELS_AT_ONCE : JOINTS;
        send(first, end);
        read_line();
    }
}
