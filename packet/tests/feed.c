/* Feeds standard input byte by byte to facewire_feed(). For each byte that ends a frame, prints the packet's sequence
 * number and last coefficient, or the error number. */
#include <stdio.h>

#include "facewire_packet.h"

int main(void) {
    static struct facewire_line line;
    struct facewire_packet packet;
    int byte;
    while ((byte = getchar()) != EOF) {
        int result = facewire_feed(&line, (uint8_t)byte, &packet);
        if (result == FACEWIRE_MORE) continue;
        if (result != FACEWIRE_OK) printf("%d ", result);
        else printf("%d %d ", packet.sequence, packet.coefficients[FACEWIRE_TONGUE_OUT]);
    }
    return 0;
}
