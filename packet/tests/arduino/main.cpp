// Runs the Arduino sketch on the bytes of standard input, one byte per simulated millisecond. Prints the pulses of its
// three servos after the last byte and again one second later.
#include <algorithm>
#include <cstdio>
#include <vector>

static unsigned long clock_ms = 0;
static unsigned long millis() { return clock_ms; }

static float constrain(float value, float least, float most) { return std::max(least, std::min(value, most)); }

struct SerialPort {
    std::vector<int> bytes;
    void begin(unsigned long) {}
    int available() const { return (int)bytes.size(); }
    int read() {
        int byte = bytes.front();
        bytes.erase(bytes.begin());
        return byte;
    }
} Serial;

#include "../../arduino/head/head.ino"

static void print_pulses() {
    for (const Servo &servo : servos) std::printf("%d ", servo.pulse_us);
}

int main() {
    setup();
    for (int byte = std::getchar(); byte != EOF; byte = std::getchar()) {
        Serial.bytes.push_back(byte);
        clock_ms++;
        loop();
    }
    print_pulses();
    for (int ms = 0; ms < 1000; ms++) {
        clock_ms++;
        loop();
    }
    print_pulses();
    return 0;
}
