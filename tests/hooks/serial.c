/* A serial driver that supports only some baud rates, because its UART divides a base rate by a whole number. Like real
 * drivers, it sets the nearest rate without an error, and reports that rate in the terminal's settings. A test preloads this
 * library into a program, and gives the base rate in SERIAL_BASE_BAUD: 921600 is the fastest rate of many adapters, and
 * 24000000 allows all rates that facewire takes.
 *
 * Limit: it knows the calls that set a rate by its number (TCSETS2, TCSETSW2 and TCSETSF2), not those that choose a rate
 * from a list (TCSETS).
 *
 * Build: cc -O1 -shared -fPIC -o serial.so serial.c -ldl */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <stdlib.h>

#include <asm/ioctls.h>
#include <asm/termbits.h>

/* Returns the rate that a UART with this base rate sets when it is asked for another. */
static speed_t made(speed_t base, speed_t asked)
{
    speed_t divisor = asked ? (base + asked / 2) / asked : 1;
    return base / (divisor ? divisor : 1);
}

int ioctl(int descriptor, unsigned long request, ...)
{
    static int (*hidden)(int, unsigned long, ...);
    if (!hidden)
        hidden = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
    va_list values;
    va_start(values, request);
    void *argument = va_arg(values, void *);
    va_end(values);
    const char *base = getenv("SERIAL_BASE_BAUD");
    if (!base || (request != TCSETS2 && request != TCSETSW2 && request != TCSETSF2))
        return hidden(descriptor, request, argument);
    struct termios2 settings = *(const struct termios2 *)argument;
    settings.c_ispeed = settings.c_ospeed = made((speed_t)strtoul(base, NULL, 10), settings.c_ospeed);
    return hidden(descriptor, request, &settings);
}
