// Stands in for Arduino's library of this name: keeps the last pulse.
struct Servo {
    int pulse_us = 0;
    void attach(int) {}
    void writeMicroseconds(int us) { pulse_us = us; }
};
