// Stand-ins for Espressif's WiFi and LEDC, after their documentation. The network comes and goes by itself, but after a loss
// it stays away until begin() is called again.
#pragma once
#include "Arduino.h"

#ifndef ESP_ARDUINO_VERSION_MAJOR
#define ESP_ARDUINO_VERSION_MAJOR 3
#endif
#define OUTPUTS 3

enum wl_status_t { WL_CONNECTED = 3, WL_DISCONNECTED = 6 };
enum wifi_mode_t { WIFI_STA = 1 };

struct WiFiClass {
    bool network = false, joined = false, sleeps = true;
    int begun = 0;
    wifi_mode_t current = (wifi_mode_t)0;
    bool setHostname(const char *) { return current == 0; } // has no effect later
    bool mode(wifi_mode_t wanted) {
        current = wanted;
        return true;
    }
    bool setSleep(bool enabled) {
        sleeps = enabled;
        return current != 0;
    }
    wl_status_t begin(const char *, const char *) {
        begun++;
        joined = network;
        return status();
    }
    bool disconnect() {
        joined = false;
        return true;
    }
    wl_status_t status() const { return joined ? WL_CONNECTED : WL_DISCONNECTED; }
    int localIP() const { return 0; }
};
static WiFiClass WiFi;

// Width of a pulse in counts, and the bits and frequency of the pin (version 3) or channel (version 2).
static std::map<int, uint32_t> duties;
static uint32_t ledc_bits = 0, ledc_hertz = 0;
static void set_up_ledc(uint32_t hertz, uint8_t bits) {
    if (bits > 14) std::exit(3); // more than most kinds have
    ledc_hertz = hertz;
    ledc_bits = bits;
}
static void ledcWrite(uint8_t pin_or_channel, uint32_t duty) { duties[pin_or_channel] = duty; }
#if ESP_ARDUINO_VERSION_MAJOR >= 3
static bool ledcAttach(uint8_t, uint32_t hertz, uint8_t bits) {
    set_up_ledc(hertz, bits);
    return true;
}
static int pulse_us(int i) { return (int)((uint64_t)duties[25 + i] * 1000000 / ledc_hertz >> ledc_bits); }
#else
static std::map<int, int> channels;
static uint32_t ledcSetup(uint8_t, uint32_t hertz, uint8_t bits) {
    set_up_ledc(hertz, bits);
    return hertz;
}
static void ledcAttachPin(uint8_t pin, uint8_t channel) { channels[pin] = channel; }
static int pulse_us(int i) { return (int)((uint64_t)duties[channels.at(25 + i)] * 1000000 / ledc_hertz >> ledc_bits); }
#endif
