// A small Servo library for the timer 1 of an ATmega328P, so that the sketch can be tried without Arduino's, which Debian does
// not have. It makes one pulse after another, and begins anew every 20 ms.
#pragma once
#include <Arduino.h>

class Servo {
public:
    Servo();
    uint8_t attach(int pin);
    void detach();
    void writeMicroseconds(int us);

private:
    uint8_t index;
};
