/* Counts the calls of Rust and C code that allocate or free memory, by thread and by caller. A test preloads this library
 * into a program, names an empty file in ALLOCATIONS_FILE, and reads the counters from this file while the program runs.
 * Build: cc -O2 -shared -fPIC -o allocations.so allocations.c */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#define MOST_COUNTERS 4096
struct counter {
    /* Number of the thread; 0 while the counter is free. */
    uint64_t thread;
    /* The return address of the call. */
    uint64_t caller;
    uint64_t calls;
};
static struct counter *counters;

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);
extern void __libc_free(void *);

__attribute__((constructor)) static void map_counters(void)
{
    const char *path = getenv("ALLOCATIONS_FILE");
    int file = path ? open(path, O_RDWR) : -1;
    size_t bytes = MOST_COUNTERS * sizeof *counters;
    if (file < 0 || ftruncate(file, (off_t)bytes) != 0)
        return;
    void *mapped = (void *)syscall(SYS_mmap, NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    counters = mapped == MAP_FAILED ? NULL : mapped;
    close(file);
}

/* Each pair of thread and caller takes the first free counter. Pairs that find no free counter share the last one. */
static void count(void *return_address)
{
    uint64_t thread = (uint64_t)syscall(SYS_gettid), caller = (uint64_t)(uintptr_t)return_address;
    if (!counters)
        return;
    for (size_t i = 0; i < MOST_COUNTERS; i++)
    {
        uint64_t nobody = 0;
        int is_taken = __atomic_compare_exchange_n(&counters[i].thread, &nobody, thread, 0, __ATOMIC_RELAXED, __ATOMIC_RELAXED);
        if (is_taken)
            counters[i].caller = caller;
        if (i == MOST_COUNTERS - 1 || (counters[i].thread == thread && counters[i].caller == caller))
        {
            __atomic_fetch_add(&counters[i].calls, 1, __ATOMIC_RELAXED);
            return;
        }
    }
}

#define COUNT() count(__builtin_return_address(0))

void *malloc(size_t bytes)
{
    COUNT();
    return __libc_malloc(bytes);
}

void *calloc(size_t elements, size_t bytes)
{
    COUNT();
    return __libc_calloc(elements, bytes);
}

void *realloc(void *old, size_t bytes)
{
    COUNT();
    return __libc_realloc(old, bytes);
}

void free(void *memory)
{
    if (memory)
        COUNT();
    __libc_free(memory);
}

void *memalign(size_t alignment, size_t bytes)
{
    COUNT();
    return __libc_memalign(alignment, bytes);
}

void *aligned_alloc(size_t alignment, size_t bytes)
{
    COUNT();
    return __libc_memalign(alignment, bytes);
}

int posix_memalign(void **out, size_t alignment, size_t bytes)
{
    COUNT();
    void *memory = __libc_memalign(alignment, bytes);
    if (memory)
        *out = memory;
    return memory ? 0 : ENOMEM;
}

void *mmap(void *at, size_t bytes, int protection, int flags, int file, off_t offset)
{
    COUNT();
    return (void *)syscall(SYS_mmap, at, bytes, protection, flags, file, offset);
}

int munmap(void *at, size_t bytes)
{
    COUNT();
    return (int)syscall(SYS_munmap, at, bytes);
}

int brk(void *end)
{
    COUNT();
    return syscall(SYS_brk, end) == (long)(uintptr_t)end ? 0 : (errno = ENOMEM, -1);
}
