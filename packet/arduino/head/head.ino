// A jaw and two eyelids that follow facewire over a serial line. SPDX-License-Identifier: MIT OR Apache-2.0
//
// For boards with at least 2 KB of memory. Copy include/facewire_packet.h to this folder. Adjust pins and pulse widths to
// your servos, and try them before you attach the linkage.

#include <Servo.h>

#include "facewire_packet.h"

// Serial is the USB connector, on an Uno also pin 0. On boards with a second serial port, Serial1 is the RX pin.
#define LINE Serial

const unsigned long BAUD = 115200;
// Shortest time for the full range of motion, also when returning to neutral after packets have stopped.
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
struct facewire_packet face; // all zero at first, which is the neutral face
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
