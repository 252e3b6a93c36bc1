// A jaw and two eyelids that follow facewire over a serial line. SPDX-License-Identifier: MIT OR Apache-2.0
//
// For an Arduino Uno and other boards with the Servo library and 2 KB of memory. Copy facewire_packet.h to this folder.
// Adjust pins and pulse widths to your servos, and try them before you attach the linkage.

#include <Servo.h>

#include "facewire_packet.h"

// Serial is the USB connector, on an Uno also pin 0. On boards with a second serial port, Serial1 is the RX pin.
#define LINE Serial

const unsigned long BAUD = 115200;
const uint32_t PULSE_MS = 20; // servos take a new position once per pulse
// Servos start one after another, because together they pull the supply down.
const uint32_t START_MS = 200;
// After this time without packets the servos get no pulses, so that they neither hum nor heat. 0 keeps the pulses.
const uint32_t RELEASE_MS = 10000;

struct Joint {
    uint8_t pin;
    uint8_t blendshape;
    int neutral_us; // pulse at coefficient 0
    int full_us;    // pulse at coefficient 1; no pulse lies outside of these two
    int travel_ms;  // shortest time from one to the other
};

const Joint joints[] = {
    {9, FACEWIRE_JAW_OPEN, 1000, 1600, 250},
    {10, FACEWIRE_EYE_BLINK_LEFT, 1800, 1200, 100},
    {11, FACEWIRE_EYE_BLINK_RIGHT, 1200, 1800, 100},
};
const uint8_t JOINTS = sizeof joints / sizeof joints[0];

Servo servos[JOINTS];
int pulses_us[JOINTS];
uint8_t started = 0; // number of servos that get pulses
struct facewire_line line;
struct facewire_packet packet;
struct facewire_receiver receiver; // all zero at first, which is the neutral face
uint32_t moved_ms = 0, started_ms = 0, heard_ms = 0;

void setup() {
    LINE.begin(BAUD);
    for (uint8_t i = 0; i < JOINTS; i++) pulses_us[i] = joints[i].neutral_us;
}

// Takes what has come. The number of bytes is bounded, so that a line full of garbage does not keep the servos waiting.
void read_line() {
    for (uint8_t i = 0; i < 200 && LINE.available() > 0; i++) {
        if (facewire_feed(&line, (uint8_t)LINE.read(), &packet) == FACEWIRE_OK) {
            facewire_receive(&receiver, &packet, millis());
        }
    }
}

void start_next(uint32_t now_ms) {
    if (started == JOINTS || now_ms - started_ms < START_MS) return;
    // In this order, because attach() begins with the pulse that was written before.
    servos[started].writeMicroseconds(pulses_us[started]);
    servos[started].attach(joints[started].pin);
    started++;
    started_ms = now_ms;
}

void release_all() {
    while (started > 0) servos[--started].detach();
}

void move(uint8_t i) {
    const Joint &joint = joints[i];
    long range_us = joint.full_us - joint.neutral_us;
    long wanted_us = joint.neutral_us + range_us * facewire_shown(&receiver, joint.blendshape) / FACEWIRE_COEFFICIENT_ONE;
    long step_us = 1 + labs(range_us) * (long)PULSE_MS / joint.travel_ms;
    pulses_us[i] += (int)constrain(wanted_us - pulses_us[i], -step_us, step_us);
    servos[i].writeMicroseconds(pulses_us[i]);
}

void loop() {
    read_line();
    uint32_t now_ms = millis();
    if (now_ms - moved_ms < PULSE_MS) return;
    moved_ms = now_ms;
    facewire_update(&receiver, now_ms);
    if (receiver.receiving) {
        heard_ms = now_ms;
        start_next(now_ms);
    } else if (RELEASE_MS > 0 && now_ms - heard_ms >= RELEASE_MS) {
        release_all();
    }
    for (uint8_t i = 0; i < started; i++) move(i);
}
