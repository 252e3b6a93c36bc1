/* Runs a facewire_receiver on the events of standard input. An event is one byte, a time in milliseconds as a
 * little-endian u32, and for 'R' a packet: 'T' sets the travel time, 'R' receives, 'S' shows. Prints for 'R' what
 * facewire_receive() returns or the error number, for 'S' whether packets come, the rotation and the coefficients. */
#include <stdio.h>

#include "facewire_packet.h"

static struct facewire_receiver receiver;

static void receive(uint32_t now_ms) {
    static struct facewire_packet packet;
    uint8_t bytes[FACEWIRE_PACKET_BYTES];
    size_t length = fread(bytes, 1, sizeof bytes, stdin);
    int result = facewire_decode(bytes, length, &packet);
    printf("%d ", result == FACEWIRE_OK ? facewire_receive(&receiver, &packet, now_ms) : result);
}

static void show(uint32_t now_ms) {
    int16_t rotation[4];
    facewire_update(&receiver, now_ms);
    facewire_shown_rotation(&receiver, rotation);
    printf("%d ", receiver.receiving);
    for (int i = 0; i < 4; i++) printf("%d ", rotation[i]);
    for (int i = 0; i < FACEWIRE_BLENDSHAPES; i++) printf("%d ", facewire_shown(&receiver, i));
}

int main(void) {
    uint8_t event[5];
    while (fread(event, 1, sizeof event, stdin) == sizeof event) {
        uint32_t now_ms = facewire_u16(event + 1) | (uint32_t)facewire_u16(event + 3) << 16;
        if (event[0] == 'T') receiver.travel_ms = (uint16_t)now_ms;
        else if (event[0] == 'R') receive(now_ms);
        else show(now_ms);
    }
    return 0;
}
