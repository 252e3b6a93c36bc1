/* Carries what a program writes to a simulated serial device, and what the device answers. A test preloads this library into
 * the program. A write returns when the device has answered, and the answer can be read at once. So no answer is late, however
 * busy the machine is. (The kernel moves the bytes of a pseudo-terminal by a thread of its own, which may take seconds.)
 *
 * The device listens at a socket with the abstract name "facewire-answers-DEVICE-NODE", where DEVICE is the st_dev and NODE
 * the st_rdev of the terminal. For each write there is a connection: the program sends the number of its bytes and the bytes,
 * and the device sends the number of bytes of its answer, and the answer. Numbers are of the type uint32_t.
 *
 * A terminal without such a socket is as it is without this library. So is what a device sends without being asked.
 *
 * Limit: it knows write, read, poll, ppoll, tcflush, close and the ioctl FIONREAD. No wait is longer than WAIT_S.
 *
 * Build: cc -O1 -shared -fPIC -o answers.so answers.c -ldl */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/time.h>
#include <sys/un.h>

#define HIDDEN(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

enum { WAIT_S = 10, FIRST_PTY_MAJOR = 136, LAST_PTY_MAJOR = 143, DESCRIPTORS = 256, ANSWER_BYTES = 1024 };

/* What was answered at each descriptor and has not been read yet. */
static struct answers {
    unsigned char bytes[ANSWER_BYTES];
    _Atomic size_t length;
} all_answers[DESCRIPTORS];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

/* Returns the answers of this descriptor, or NULL if it cannot have any. */
static struct answers *answers_of(int descriptor)
{
    return descriptor >= 0 && descriptor < DESCRIPTORS ? &all_answers[descriptor] : NULL;
}

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
    HIDDEN(close)(device);
    return -1;
}

/* Keeps an answer for the reader of this terminal. What does not fit is lost, and standard error says so. */
static void keep(int terminal, const unsigned char *answer, size_t length)
{
    struct answers *answers = answers_of(terminal);
    pthread_mutex_lock(&lock);
    int fits = answers && length <= ANSWER_BYTES - answers->length;
    if (fits) {
        memcpy(answers->bytes + answers->length, answer, length);
        answers->length += length;
    }
    pthread_mutex_unlock(&lock);
    if (!fits)
        fprintf(stderr, "answers.c: no place for an answer at descriptor %d\n", terminal);
}

static void forget(int descriptor)
{
    struct answers *answers = answers_of(descriptor);
    // Most descriptors have none.
    if (!answers || !answers->length)
        return;
    pthread_mutex_lock(&lock);
    answers->length = 0;
    pthread_mutex_unlock(&lock);
}

ssize_t write(int descriptor, const void *bytes, size_t length)
{
    int saved = errno;
    int device = length > 0 ? device_of(descriptor) : -1;
    if (device < 0) {
        errno = saved;
        return HIDDEN(write)(descriptor, bytes, length);
    }
    uint32_t count = (uint32_t)length;
    uint32_t answered = 0;
    unsigned char answer[ANSWER_BYTES];
    int is_answered = send(device, &count, sizeof count, MSG_NOSIGNAL) == sizeof count &&
                      send(device, bytes, length, MSG_NOSIGNAL) == (ssize_t)length &&
                      recv(device, &answered, sizeof answered, MSG_WAITALL) == sizeof answered && answered <= sizeof answer &&
                      recv(device, answer, answered, MSG_WAITALL) == (ssize_t)answered;
    HIDDEN(close)(device);
    if (is_answered && answered > 0)
        keep(descriptor, answer, answered);
    if (!is_answered)
        fprintf(stderr, "answers.c: no answer, or one of more than %d bytes, at descriptor %d\n", ANSWER_BYTES, descriptor);
    errno = saved;
    return (ssize_t)length;
}

ssize_t read(int descriptor, void *bytes, size_t length)
{
    struct answers *answers = answers_of(descriptor);
    if (!answers || !answers->length)
        return HIDDEN(read)(descriptor, bytes, length);
    pthread_mutex_lock(&lock);
    size_t count = length < answers->length ? length : answers->length;
    memcpy(bytes, answers->bytes, count);
    answers->length -= count;
    memmove(answers->bytes, answers->bytes + count, answers->length);
    pthread_mutex_unlock(&lock);
    // Another thread may have flushed or closed it meanwhile.
    return count > 0 ? (ssize_t)count : HIDDEN(read)(descriptor, bytes, length);
}

/* Marks the descriptors that have an answer, and returns how many there are. */
static int mark_answered(struct pollfd *polled, nfds_t count)
{
    int marked = 0;
    for (nfds_t place = 0; place < count; place++) {
        struct answers *answers = answers_of(polled[place].fd);
        int is_answered = answers && answers->length && (polled[place].events & POLLIN);
        polled[place].revents = is_answered ? POLLIN : 0;
        marked += is_answered;
    }
    return marked;
}

int poll(struct pollfd *polled, nfds_t count, int timeout_ms)
{
    int marked = mark_answered(polled, count);
    return marked ? marked : HIDDEN(poll)(polled, count, timeout_ms);
}

int ppoll(struct pollfd *polled, nfds_t count, const struct timespec *timeout, const sigset_t *mask)
{
    int marked = mark_answered(polled, count);
    return marked ? marked : HIDDEN(ppoll)(polled, count, timeout, mask);
}

int tcflush(int descriptor, int queues)
{
    if (queues != TCOFLUSH)
        forget(descriptor);
    return HIDDEN(tcflush)(descriptor, queues);
}

int close(int descriptor)
{
    forget(descriptor);
    return HIDDEN(close)(descriptor);
}

int ioctl(int descriptor, unsigned long request, ...)
{
    va_list values;
    va_start(values, request);
    void *argument = va_arg(values, void *);
    va_end(values);
    int result = HIDDEN(ioctl)(descriptor, request, argument);
    struct answers *answers = answers_of(descriptor);
    if (!result && request == FIONREAD && answers)
        *(int *)argument += (int)answers->length;
    return result;
}
