/* A plugin for qemu's user emulation that counts the instructions a program executes, by function.
 *
 * It writes one line for each function to the file that the argument out= names. The columns are: all instructions;
 * multiply-adds; other vector instructions; 64-bit words loaded; loads; stores; branches; other instructions; misses of
 * the first cache; misses of the second cache; name of the function. The columns from multiply-adds to other instructions
 * are 0 on other architectures than aarch64. Code without symbols is counted under the name of its file.
 *
 * The argument caches=L1_KIB:L1_WAYS:L2_KIB:L2_WAYS simulates two levels of cache with lines of 64 bytes. Each level
 * replaces the least recently used line. The simulation is slow and has no prefetcher.
 *
 * Build: gcc -O2 -shared -fPIC -o instructions.so instructions.c
 * Run:   qemu-aarch64 -plugin ./instructions.so,out=FILE PROGRAM
 *
 * No package of Debian 12 contains qemu's header. The declarations below are the parts of version 1 of its plugin
 * interface that this file uses. */
#define _GNU_SOURCE
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t plugin_id;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void (*on_block)(plugin_id, struct qemu_plugin_tb *);
typedef void (*on_access)(unsigned cpu, uint32_t access, uint64_t address, void *data);
extern void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, on_block);
extern void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *, int add, void *counter, uint64_t value);
extern void qemu_plugin_register_vcpu_mem_cb(struct qemu_plugin_insn *, on_access, int registers, int accesses, void *data);
extern void qemu_plugin_register_atexit_cb(plugin_id, void (*)(plugin_id, void *), void *);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern const char *qemu_plugin_insn_symbol(const struct qemu_plugin_insn *);
extern const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);
extern void *qemu_plugin_insn_haddr(const struct qemu_plugin_insn *);

#define EXPORT __attribute__((visibility("default")))
EXPORT int qemu_plugin_version = 1;

enum { ALL, MULTIPLY_ADDS, OTHER_VECTOR, WORDS_LOADED, LOADS, STORES, BRANCHES, OTHER, L1_MISSES, L2_MISSES, COUNTERS };
struct function {
    char *name;
    uint64_t counters[COUNTERS];
};

#define MOST_FUNCTIONS 16384
static struct function functions[MOST_FUNCTIONS];
static size_t known_functions;
static char *out_path;
static int is_aarch64;

static struct function *function_called(const char *name)
{
    for (size_t i = 0; i < known_functions; i++)
        if (!strcmp(functions[i].name, name))
            return &functions[i];
    if (known_functions == MOST_FUNCTIONS)
        abort();
    functions[known_functions].name = strdup(name);
    return &functions[known_functions++];
}

/* Returns the name of the file that is mapped at an address of qemu's own process. */
static const char *file_at(uintptr_t address)
{
    static char line[4096], name[256];
    static uintptr_t from, to;
    if (address >= from && address < to)
        return name;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps))
    {
        unsigned long long first, end;
        char path[2048] = "";
        if (sscanf(line, "%llx-%llx %*s %*s %*s %*s %2047s", &first, &end, path) < 2 || address < first || address >= end)
            continue;
        const char *slash = strrchr(path, '/');
        from = first, to = end;
        snprintf(name, sizeof name, "%.250s", slash ? slash + 1 : *path ? path : "[no file]");
        fclose(maps);
        return name;
    }
    if (maps)
        fclose(maps);
    return "[no file]";
}

/* --- the caches --- */

#define LINE_BYTES 64
struct cache {
    size_t sets, ways;
    /* The lines of each set, most recently used first. */
    uint64_t *lines;
};
static struct cache l1, l2;

static void make_cache(struct cache *cache, size_t kib, size_t ways)
{
    cache->ways = ways;
    cache->sets = kib * 1024 / LINE_BYTES / ways;
    cache->lines = calloc(cache->sets * ways, sizeof *cache->lines);
}

/* Returns whether a line is in the cache, and makes it the most recently used line. */
static int is_cached(struct cache *cache, uint64_t line)
{
    uint64_t *set = cache->lines + line % cache->sets * cache->ways;
    size_t at = 0;
    while (at < cache->ways - 1 && set[at] != line)
        at++;
    int found = set[at] == line;
    memmove(set + 1, set, at * sizeof *set);
    set[0] = line;
    return found;
}

static void accessed(unsigned cpu, uint32_t access, uint64_t address, void *data)
{
    struct function *function = data;
    uint64_t line = address / LINE_BYTES;
    (void)cpu, (void)access;
    if (is_cached(&l1, line))
        return;
    function->counters[L1_MISSES]++;
    if (!is_cached(&l2, line))
        function->counters[L2_MISSES]++;
}

/* --- instructions of aarch64, by the groups of their encoding --- */

/* Returns how many 64-bit words a load or store moves. A smaller amount counts as one word. */
static unsigned words_of(uint32_t word)
{
    unsigned is_vector = word >> 26 & 1, size = word >> 30;
    if ((word & 0x38000000) == 0x28000000) /* a pair of registers */
        return is_vector ? 1u << size : size == 2 ? 2 : 1;
    if ((word & 0xbf000000) == 0x0c000000) /* several whole vector registers */
    {
        unsigned opcode = word >> 12 & 15, is_wide = word >> 30 & 1;
        unsigned registers = opcode == 7 ? 1 : opcode == 8 || opcode == 10 ? 2 : opcode == 4 || opcode == 6 ? 3 : 4;
        return registers << is_wide;
    }
    if ((word & 0x3b000000) == 0x18000000) /* a literal */
        return is_vector && size == 2 ? 2 : 1;
    return is_vector && !size && (word >> 23 & 1) ? 2 : 1;
}

static int is_load(uint32_t word)
{
    unsigned is_vector = word >> 26 & 1, kind = word >> 22 & 3;
    if ((word & 0x38000000) == 0x28000000 || (word & 0xbe000000) == 0x0c000000)
        return kind & 1;
    return (word & 0x3b000000) == 0x18000000 || (kind != 0 && !(is_vector && kind == 2));
}

static int is_multiply_add(uint32_t word)
{
    uint32_t by_element = word & 0xbf00f400, whole = word & 0xbfa0fc00, half = word & 0xbfe0fc00;
    return by_element == 0x0f001000 || by_element == 0x0f009000 || /* fmla, fmul */
           whole == 0x0e20cc00 || whole == 0x2e20dc00 || half == 0x0e400c00 || half == 0x2e401c00;
}

static void classify(uint32_t word, uint64_t *counts)
{
    if ((word & 0x0a000000) == 0x08000000)
    {
        counts[is_load(word) ? LOADS : STORES]++;
        if (is_load(word))
            counts[WORDS_LOADED] += words_of(word);
    }
    else if ((word & 0x1c000000) == 0x14000000)
        counts[BRANCHES]++;
    else if ((word & 0x0e000000) == 0x0e000000)
        counts[is_multiply_add(word) ? MULTIPLY_ADDS : OTHER_VECTOR]++;
    else
        counts[OTHER]++;
}

/* --- the plugin --- */

/* Is called when qemu translates a block of instructions. Each time the block runs, its counts are added to the function
 * that contains its first instruction. */
static void translated(plugin_id id, struct qemu_plugin_tb *block)
{
    uint64_t counts[COUNTERS] = {0};
    struct qemu_plugin_insn *first = qemu_plugin_tb_get_insn(block, 0);
    const char *symbol = qemu_plugin_insn_symbol(first);
    if (!symbol || !*symbol)
        symbol = file_at((uintptr_t)qemu_plugin_insn_haddr(first));
    struct function *function = function_called(symbol);
    (void)id;
    counts[ALL] = qemu_plugin_tb_n_insns(block);
    for (size_t i = 0; i < counts[ALL]; i++)
    {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
        if (is_aarch64)
        {
            uint32_t word;
            memcpy(&word, qemu_plugin_insn_data(instruction), sizeof word);
            classify(word, counts);
        }
        if (l1.lines)
            qemu_plugin_register_vcpu_mem_cb(instruction, accessed, 0, 3, function);
    }
    for (int i = 0; i < COUNTERS; i++)
        if (counts[i])
            qemu_plugin_register_vcpu_tb_exec_inline(block, 0, &function->counters[i], counts[i]);
}

static void finished(plugin_id id, void *data)
{
    (void)id, (void)data;
    FILE *out = out_path ? fopen(out_path, "w") : stderr;
    for (size_t i = 0; out && i < known_functions; i++)
    {
        for (int counter = 0; counter < COUNTERS; counter++)
            fprintf(out, "%llu\t", (unsigned long long)functions[i].counters[counter]);
        fprintf(out, "%s\n", functions[i].name);
    }
    if (out)
        fclose(out);
}

/* The first member of `info` is the name of the emulated architecture. */
EXPORT int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv)
{
    is_aarch64 = !strcmp(*(const char *const *)info, "aarch64");
    for (int i = 0; i < argc; i++)
    {
        unsigned long size[4];
        if (sscanf(argv[i], "caches=%lu:%lu:%lu:%lu", &size[0], &size[1], &size[2], &size[3]) == 4)
        {
            make_cache(&l1, size[0], size[1]);
            make_cache(&l2, size[2], size[3]);
        }
        if (!strncmp(argv[i], "out=", 4))
            out_path = strdup(argv[i] + 4);
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, finished, NULL);
    return 0;
}
