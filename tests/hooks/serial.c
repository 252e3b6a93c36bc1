/* A serial driver that makes only some baud rates: its UART divides a base rate by whole numbers. As drivers do, it sets the
 * nearest rate without an error, and shows in the terminal's settings what it has set. A test preloads this library into a
 * program, and gives the base rate in SERIAL_BASE_BAUD: 921600 is the fastest rate of many adapters, and 24000000 makes all
 * rates that facewire takes.
 *
 * Limit: it knows the calls that set a rate by its number (TCSETS2 and its kin), not those that choose one of a list.
 *
 * Build: cc -O1 -shared -fPIC -o serial.so serial.c -ldl */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <stdlib.h>

#include <asm/ioctls.h>
#include <asm/termbits.h>

/* The rate that a UART with this base rate makes of the one that it is asked for. */
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
