// A stand-in for Wire with a PCA9685 at address 0x40, after its data sheet. A transfer takes the time of its bits.
#pragma once
#include "Arduino.h"

#define OUTPUTS 9
#define HAS_WIRE
// As the one for AVR, it has a timeout, but not the macro WIRE_HAS_TIMEOUT.
#define ARDUINO_ARCH_AVR

struct TwoWire {
    static const size_t ROOM = 32;
    uint8_t registers[256] = {};
    std::deque<uint8_t> sent, answer;
    unsigned long hertz = 100000, timeout_us = 0;
    bool hangs = false;
    uint8_t at = 0;
    TwoWire() { power_on(); }
    // All outputs are off, and the oscillator sleeps.
    void power_on() {
        for (int i = 0; i < 256; i++) registers[i] = 0;
        registers[0x00] = 0x11;
        registers[0x01] = 0x04;
        registers[0xFE] = 0x1E;
        for (int channel = 0; channel < 16; channel++) registers[9 + 4 * channel] = 0x10;
    }
    void begin() {}
    void setClock(unsigned long clock) { hertz = clock; }
    void setWireTimeout(unsigned long us, bool) { timeout_us = us; }
    void beginTransmission(uint8_t) { sent.clear(); }
    size_t write(uint8_t byte) {
        if (sent.size() == ROOM) return 0;
        sent.push_back(byte);
        return 1;
    }
    bool transfer(size_t bytes) {
        pass_us(hangs ? timeout_us : (bytes + 1) * 9 * 1000000 / hertz);
        if (hangs && timeout_us == 0) std::exit(3); // a real one would never return
        return !hangs;
    }
    uint8_t endTransmission() {
        if (!transfer(sent.size())) return 5;
        at = sent.front();
        sent.pop_front();
        for (uint8_t byte : sent) store(byte);
        return 0;
    }
    void store(uint8_t byte) {
        bool sleeps = registers[0] & 0x10;
        if (at >= 0xFA && at <= 0xFD) {
            for (int channel = 0; channel < 16; channel++) registers[6 + 4 * channel + at - 0xFA] = byte;
        } else if (at != 0xFE || sleeps) {
            registers[at] = byte;
        }
        if (registers[0] & 0x20) at++;
    }
    uint8_t requestFrom(uint8_t, uint8_t bytes) {
        if (!transfer(bytes)) return 0;
        answer.push_back(registers[at]);
        return 1;
    }
    int read() {
        int byte = answer.empty() ? -1 : answer.front();
        if (!answer.empty()) answer.pop_front();
        return byte;
    }
};
static TwoWire Wire;

// The pulse of a channel: its share of 4096 counts of the prescaled clock of 25 MHz.
static int pulse_us(int channel) {
    const uint8_t *bytes = Wire.registers + 6 + 4 * channel;
    bool is_off = (Wire.registers[0] & 0x10) || (bytes[3] & 0x10) || levels[7] == HIGH;
    return is_off ? 0 : (bytes[2] + (bytes[3] << 8)) * (Wire.registers[0xFE] + 1) / 25;
}
