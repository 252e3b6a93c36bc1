// Runs an Arduino sketch on the commands of standard input: a letter, a number (little-endian u32), and bytes where the
// number counts them.
//   S  starts the clock at this time in milliseconds and calls setup()
//   L  puts bytes on the serial line           W  lets the sketch run for so many milliseconds
//   D  delivers a datagram                     N  switches the network on (1) or off (0)
//   H  lets the I2C bus hang (1) or not (0)    R  takes the power of the servo board for a moment
//   P  prints the pulse of each servo in microseconds, 0 for none, and how many bytes the serial port has lost
#include SKETCH


static std::deque<uint8_t> bytes_of_input(uint32_t count) {
    std::deque<uint8_t> bytes;
    while (count-- > 0) bytes.push_back((uint8_t)std::getchar());
    return bytes;
}

static void run_for(uint32_t ms) {
    uint64_t end_us = clock_us + 1000ull * ms;
    while (clock_us < end_us) {
        loop();
        pass_us(50);
    }
}

static void print_pulses() {
    for (int i = 0; i < OUTPUTS; i++) std::printf("%d ", pulse_us(i));
    std::printf("%ld ", Serial.lost);
}

static void obey(int letter, uint32_t number) {
    switch (letter) {
    case 'S':
        clock_us = 1000ull * number;
        setup();
        break;
    case 'W': run_for(number); break;
    case 'P': print_pulses(); break;
    case 'L':
        for (uint8_t byte : bytes_of_input(number)) Serial.on_the_line.push_back(byte);
        break;
#ifdef HAS_WIRE
    case 'H': Wire.hangs = number; break;
    case 'R': Wire.power_on(); break;
#endif
#ifdef ESP_ARDUINO_VERSION_MAJOR
    case 'D': datagrams.push_back(bytes_of_input(number)); break;
    case 'N':
        WiFi.network = number;
        if (!number) WiFi.joined = false;
        break;
#endif
    default: std::exit(2);
    }
}

int main() {
    for (int letter = std::getchar(); letter != EOF; letter = std::getchar()) {
        uint32_t number = 0;
        for (int shift = 0; shift < 32; shift += 8) number |= (uint32_t)std::getchar() << shift;
        obey(letter, number);
    }
    return 0;
}
