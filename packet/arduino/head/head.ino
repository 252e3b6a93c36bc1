// A jaw and two eyelids that follow facewire by a serial line. SPDX-License-Identifier: MIT OR Apache-2.0
//
// For boards with 2 KB of memory and more. Copy include/facewire_packet.h beside this file. Adjust pins and pulses to your
// servos, and try them without the linkage first.

#include <Servo.h>

#include "facewire_packet.h"

// Serial is the USB connector, on an Uno pin 0 too. Boards with a further line have Serial1 at their RX pin.
#define LINE Serial

const unsigned long BAUD = 115200;
// Fastest way from one end to the other, also back to neutral when packets stop.
const float FULL_TRAVEL_MS = 250;

struct Joint {
    int pin;
    int blendshape;
    float neutral_us; // pulse at coefficient 0
    float full_us;    // pulse at coefficient 1
};

const Joint joints[] = {
    {9, FACEWIRE_JAW_OPEN, 1000, 1600},
    {10, FACEWIRE_EYE_BLINK_LEFT, 1800, 1200},
    {11, FACEWIRE_EYE_BLINK_RIGHT, 1200, 1800},
};
const int JOINTS = sizeof joints / sizeof joints[0];

Servo servos[JOINTS];
float positions[JOINTS]; // 0 to 1
struct facewire_line line;
struct facewire_packet face; // all zero: neutral
unsigned long received_ms = 0;
unsigned long moved_ms = 0;

void setup() {
    LINE.begin(BAUD);
    for (int i = 0; i < JOINTS; i++) servos[i].attach(joints[i].pin);
}

void move(int i, float wanted, float step) {
    const Joint &joint = joints[i];
    positions[i] += constrain(wanted - positions[i], -step, step);
    servos[i].writeMicroseconds((int)(joint.neutral_us + positions[i] * (joint.full_us - joint.neutral_us)));
}

void loop() {
    while (LINE.available() > 0) {
        if (facewire_feed(&line, (uint8_t)LINE.read(), &face) == FACEWIRE_OK) received_ms = millis();
    }
    unsigned long now_ms = millis();
    if (now_ms - moved_ms < 10) return;
    float step = (float)(now_ms - moved_ms) / FULL_TRAVEL_MS;
    bool silent = now_ms - received_ms > FACEWIRE_SILENCE_MS;
    for (int i = 0; i < JOINTS; i++) {
        float coefficient = (float)face.coefficients[joints[i].blendshape] / FACEWIRE_COEFFICIENT_ONE;
        move(i, silent ? 0 : coefficient, step);
    }
    moved_ms = now_ms;
}
