/* Prints the fields of the packet on standard input in one line, or the error number. */
#include <stdio.h>

#include "facewire_packet.h"

int main(void) {
    uint8_t bytes[FACEWIRE_PACKET_BYTES + 1];
    struct facewire_packet packet;
    size_t length = fread(bytes, 1, sizeof bytes, stdin);
    int result = facewire_decode(bytes, length, &packet);
    if (result != FACEWIRE_OK) {
        printf("%d", result);
        return 0;
    }
    printf("%d %d %d %d %d %lu", packet.state, packet.reason, packet.neutral_face, packet.sequence, packet.age, (unsigned long)packet.capture_us);
    for (int i = 0; i < FACEWIRE_PARTS; i++) printf(" %d", packet.visibility[i]);
    for (int i = 0; i < 4; i++) printf(" %d", packet.rotation[i]);
    for (int i = 0; i < 3; i++) printf(" %d", packet.position_mm[i]);
    for (int i = 0; i < FACEWIRE_BLENDSHAPES; i++) printf(" %d", packet.coefficients[i]);
    return 0;
}
