// A stand-in for WiFiUDP with its traps: while a datagram has unread bytes, no other one comes; an empty datagram blocks the
// port for good; and a port that was opened before the network was lost receives nothing.
#pragma once
#include "WiFi.h"

static std::deque<std::deque<uint8_t>> datagrams;

struct WiFiUDP {
    std::deque<uint8_t> current;
    int opened_at = -1;
    uint8_t begin(uint16_t) {
        opened_at = WiFi.begun;
        current.clear();
        datagrams.clear();
        return 1;
    }
    int parsePacket() {
        if (!current.empty() || datagrams.empty() || opened_at != WiFi.begun || datagrams.front().empty()) return 0;
        current = datagrams.front();
        datagrams.pop_front();
        return (int)current.size();
    }
    int read() {
        if (current.empty()) return -1;
        int byte = current.front();
        current.pop_front();
        return byte;
    }
    int read(unsigned char *buffer, size_t length) {
        size_t count = 0;
        while (count < length && !current.empty()) buffer[count++] = (unsigned char)read();
        return (int)count;
    }
};
