/* Takes the time of a simulated device out of the time that a program waits for its answer. A test preloads this library
 * into the program. Each write to a pseudo-terminal returns only after the device has read what was written, and after its
 * answer can be read. The device listens at a socket with the abstract name "facewire-answers-DEVICE-NODE", where DEVICE is
 * the st_dev and NODE the st_rdev of the terminal. It sends a byte when a write may begin, receives the number of bytes that
 * were written, and sends the number of bytes that it has answered since. The numbers are of the type uint32_t.
 *
 * Without such a socket, a write is a plain one. No write waits longer than WAIT_S.
 *
 * Limit: it knows `write`, and not `writev` or `pwrite`.
 *
 * Build: cc -O1 -shared -fPIC -o answers.so answers.c -ldl */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/time.h>
#include <sys/un.h>

enum { WAIT_S = 10, FIRST_PTY_MAJOR = 136, LAST_PTY_MAJOR = 143 };

/* Connects to the device of this terminal. Returns -1 if it is no terminal of a simulated device. */
static int device_of(int terminal)
{
    struct stat status;
    if (fstat(terminal, &status) || !S_ISCHR(status.st_mode))
        return -1;
    if (major(status.st_rdev) < FIRST_PTY_MAJOR || major(status.st_rdev) > LAST_PTY_MAJOR)
        return -1;
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    int length = snprintf(address.sun_path + 1, sizeof address.sun_path - 1, "facewire-answers-%llu-%llu",
                          (unsigned long long)status.st_dev, (unsigned long long)status.st_rdev);
    int device = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (device < 0)
        return -1;
    struct timeval most = {.tv_sec = WAIT_S};
    setsockopt(device, SOL_SOCKET, SO_RCVTIMEO, &most, sizeof most);
    setsockopt(device, SOL_SOCKET, SO_SNDTIMEO, &most, sizeof most);
    socklen_t size = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + 1 + (size_t)length);
    if (!connect(device, (struct sockaddr *)&address, size))
        return device;
    close(device);
    return -1;
}

/* Waits until so many bytes can be read. The kernel moves them from one end of a pseudo-terminal to the other by a thread of
 * its own. */
static void await_bytes(int terminal, int bytes)
{
    const struct timespec pause = {.tv_nsec = 100 * 1000};
    int readable = 0;
    for (int waited = 0; waited < WAIT_S * 10000; waited++) {
        if (ioctl(terminal, FIONREAD, &readable) || readable >= bytes)
            return;
        nanosleep(&pause, NULL);
    }
}

ssize_t write(int descriptor, const void *bytes, size_t length)
{
    static ssize_t (*hidden)(int, const void *, size_t);
    if (!hidden)
        hidden = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    int saved = errno;
    int readable = 0;
    int device = device_of(descriptor);
    char ready;
    if (device >= 0) {
        ioctl(descriptor, FIONREAD, &readable);
        recv(device, &ready, sizeof ready, MSG_WAITALL);
    }
    errno = saved;
    ssize_t written = hidden(descriptor, bytes, length);
    if (device < 0)
        return written;
    saved = errno;
    uint32_t count = written > 0 ? (uint32_t)written : 0;
    uint32_t answered = 0;
    if (send(device, &count, sizeof count, MSG_NOSIGNAL) == sizeof count &&
        recv(device, &answered, sizeof answered, MSG_WAITALL) == sizeof answered)
        await_bytes(descriptor, readable + (int)answered);
    close(device);
    errno = saved;
    return written;
}
