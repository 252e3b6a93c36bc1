// A stand-in for the Arduino library of the same name that keeps the width of the last pulse.
struct Servo {
    int pulse_us = 0;
    void attach(int) {}
    void writeMicroseconds(int us) { pulse_us = us; }
};
