// A stand-in for the Servo library: a pin has pulses while its servo is attached. The real one begins with 1500 us unless
// another width was written before, so that the servo jumps; here this ends the program.
#pragma once
#include "Arduino.h"

struct Servo {
    int us = 0, pin = -1;
    uint8_t attach(int to) {
        if (us == 0) std::exit(3);
        pin = to;
        return 0;
    }
    void detach() { pin = -1; }
    void writeMicroseconds(int value) { us = value; }
};

#define OUTPUTS 3
extern Servo servos[];
static int pulse_us(int i) { return servos[i].pin < 0 ? 0 : servos[i].us; }
