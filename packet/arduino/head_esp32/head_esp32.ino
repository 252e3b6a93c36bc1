// A jaw and two eyelids that follow facewire over Wi-Fi. SPDX-License-Identifier: MIT OR Apache-2.0
//
// For boards with an ESP32 of any kind; needs nothing but Espressif's boards in the Arduino IDE, version 2 or 3. Copy
// facewire_packet.h to this folder, and enter your network. The board prints its address when it is connected.
// Adjust pins and pulse widths to your servos, and try them before you attach the linkage.

#include <WiFi.h>
#include <WiFiUdp.h>

#include "facewire_packet.h"

const char *const NETWORK = "the name of your network";
const char *const PASSWORD = "its password";
const char *const HOST_NAME = "facewire-head"; // many routers make it known as facewire-head or facewire-head.lan
const uint16_t PORT = 5252;

const uint32_t PULSE_MS = 20; // servos take a new position once per pulse
// Servos start one after another, because together they pull the supply down, and the board with it.
const uint32_t START_MS = 200;
// After this time without packets the servos get no pulses, so that they neither hum nor heat. 0 keeps the pulses.
const uint32_t RELEASE_MS = 10000;
// The board connects again by itself, but not after every kind of loss. After this time without a connection, the
// sketch connects anew.
const uint32_t CONNECT_MS = 15000;
// After this time without packets the port is opened anew: an empty datagram or a network that came back can block it.
const uint32_t REOPEN_MS = 5000;
// All kinds of ESP32 have 14 bits for the width of a pulse: steps of 1.2 us.
const uint8_t DUTY_BITS = 14;

struct Joint {
    uint8_t pin;
    uint8_t blendshape;
    int neutral_us; // pulse at coefficient 0
    int full_us;    // pulse at coefficient 1; no pulse lies outside of these two
    int travel_ms;  // shortest time from one to the other
};

// Pins 0, 2, 5, 12, 14 and 15 carry signals while the board starts, at which servos would twitch.
const Joint joints[] = {
    {25, FACEWIRE_JAW_OPEN, 1000, 1600, 250},
    {26, FACEWIRE_EYE_BLINK_LEFT, 1800, 1200, 100},
    {27, FACEWIRE_EYE_BLINK_RIGHT, 1200, 1800, 100},
};
const uint8_t JOINTS = sizeof joints / sizeof joints[0];

int pulses_us[JOINTS];
uint8_t started = 0; // number of servos that get pulses
WiFiUDP udp;
struct facewire_packet packet;
struct facewire_receiver receiver; // all zero at first, which is the neutral face
bool connected = false;
uint32_t moved_ms = 0, started_ms = 0, heard_ms = 0, tried_ms = 0, opened_ms = 0;

void set_pulse(uint8_t i, int us) {
    uint32_t duty = ((uint32_t)us << DUTY_BITS) / (1000 * PULSE_MS);
#if ESP_ARDUINO_VERSION_MAJOR >= 3
    ledcWrite(joints[i].pin, duty);
#else
    ledcWrite(i, duty);
#endif
}

void setup() {
    Serial.begin(115200);
    for (uint8_t i = 0; i < JOINTS; i++) {
        pulses_us[i] = joints[i].neutral_us;
#if ESP_ARDUINO_VERSION_MAJOR >= 3
        ledcAttach(joints[i].pin, 1000 / PULSE_MS, DUTY_BITS);
#else
        ledcSetup(i, 1000 / PULSE_MS, DUTY_BITS);
        ledcAttachPin(joints[i].pin, i);
#endif
        set_pulse(i, 0);
    }
    WiFi.setHostname(HOST_NAME);
    WiFi.mode(WIFI_STA);
    WiFi.setSleep(false); // a radio that sleeps takes packets only every 100 ms or less often
    WiFi.begin(NETWORK, PASSWORD);
    tried_ms = millis();
}

void keep_connected(uint32_t now_ms) {
    bool was_connected = connected;
    connected = WiFi.status() == WL_CONNECTED;
    if (connected) {
        if (!was_connected || (now_ms - heard_ms >= REOPEN_MS && now_ms - opened_ms >= REOPEN_MS)) {
            udp.begin(PORT);
            opened_ms = now_ms;
        }
        if (!was_connected) {
            Serial.print("facewire: send to ");
            Serial.println(WiFi.localIP());
        }
        tried_ms = now_ms;
    } else if (now_ms - tried_ms >= CONNECT_MS) {
        WiFi.disconnect();
        WiFi.begin(NETWORK, PASSWORD);
        tried_ms = now_ms;
    }
}

// Takes what has come. The number of datagrams is bounded, so that a flood does not keep the servos waiting.
void receive_all() {
    static uint8_t bytes[FACEWIRE_PACKET_BYTES + 1];
    for (uint8_t i = 0; connected && i < 16 && udp.parsePacket() > 0; i++) {
        int length = udp.read(bytes, sizeof bytes);
        while (udp.read() >= 0) {} // the rest of a datagram that is too long: until it is read, no other one comes
        if (length > 0 && facewire_decode(bytes, (size_t)length, &packet) == FACEWIRE_OK) {
            facewire_receive(&receiver, &packet, millis());
        }
    }
}

void start_and_release(uint32_t now_ms) {
    if (receiver.receiving) {
        heard_ms = now_ms;
        if (started < JOINTS && now_ms - started_ms >= START_MS) {
            started++;
            started_ms = now_ms;
        }
    } else if (RELEASE_MS > 0 && now_ms - heard_ms >= RELEASE_MS) {
        while (started > 0) set_pulse(--started, 0);
    }
}

void move(uint8_t i) {
    const Joint &joint = joints[i];
    int range_us = joint.full_us - joint.neutral_us;
    int wanted_us = joint.neutral_us + range_us * facewire_shown(&receiver, joint.blendshape) / FACEWIRE_COEFFICIENT_ONE;
    int step_us = 1 + abs(range_us) * (int)PULSE_MS / joint.travel_ms;
    pulses_us[i] += constrain(wanted_us - pulses_us[i], -step_us, step_us);
    set_pulse(i, pulses_us[i]);
}

void loop() {
    uint32_t now_ms = millis();
    keep_connected(now_ms);
    receive_all();
    if (now_ms - moved_ms < PULSE_MS) {
        delay(1); // leaves the processor to Wi-Fi
        return;
    }
    moved_ms = now_ms;
    facewire_update(&receiver, now_ms);
    start_and_release(now_ms);
    for (uint8_t i = 0; i < started; i++) move(i);
}
