// Stand-ins for the parts of Arduino that the sketches use, on a simulated clock. The serial port loses bytes like that of an
// Uno: it holds 63, and the others are gone.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <map>

static uint64_t clock_us = 0;
static uint32_t millis() { return (uint32_t)(clock_us / 1000); }

template <typename Value, typename Least, typename Most>
static Value constrain(Value value, Least least, Most most) {
    return value < least ? (Value)least : value > most ? (Value)most : value;
}

enum { LOW, HIGH, OUTPUT };
static std::map<int, int> levels;
static void pinMode(int, int) {}
static void digitalWrite(int pin, int level) { levels[pin] = level; }

struct SerialPort {
    static const size_t ROOM = 63;
    std::deque<uint8_t> on_the_line, held;
    uint64_t next_us = 0, us_per_byte = 0;
    long lost = 0;
    void begin(unsigned long baud) { us_per_byte = 10000000 / baud; }
    int available() const { return (int)held.size(); }
    int read() {
        if (held.empty()) return -1;
        int byte = held.front();
        held.pop_front();
        return byte;
    }
    void print(const char *) {}
    template <typename Text> void println(const Text &) {}
    void arrive() {
        if (on_the_line.empty()) next_us = clock_us + us_per_byte;
        while (!on_the_line.empty() && next_us <= clock_us) {
            if (held.size() < ROOM) held.push_back(on_the_line.front());
            else lost++;
            on_the_line.pop_front();
            next_us += us_per_byte;
        }
    }
};
static SerialPort Serial;

// Lets time pass, in which bytes arrive.
static void pass_us(uint64_t us) {
    clock_us += us;
    Serial.arrive();
}
static void delay(unsigned long ms) { pass_us(1000 * ms); }
