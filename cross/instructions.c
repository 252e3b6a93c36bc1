/* Counts the instructions that a program executes under qemu's user emulation, by instruction class on aarch64 if the
 * argument classes=on is given, and by function with functions=on. qemu's header is in no package; these are the parts of its plugin interface, version 1,
 * that are used here. Build: gcc -O2 -shared -fPIC -o instructions.so instructions.c
 * Run: qemu-aarch64-static -plugin ./instructions.so PROGRAM; the count is printed to standard error at the end. */
#define _GNU_SOURCE
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
extern void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, struct qemu_plugin_tb *));
extern void qemu_plugin_register_vcpu_tb_exec_inline(struct qemu_plugin_tb *, int op, void *counter, uint64_t add);
extern void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, void (*)(qemu_plugin_id_t, void *), void *);
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
extern struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
extern const char *qemu_plugin_insn_symbol(const struct qemu_plugin_insn *);
extern const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { ALL, MULTIPLY_ADD, OTHER_VECTOR, LOAD, STORE, BRANCH, OTHER, CLASSES };
static const char *const names[CLASSES] = {"instructions", "multiply-adds", "other vector", "loads", "stores", "branches", "other"};
static uint64_t counts[CLASSES];
static int classes, functions;

/* Blocks are added to the function that their first instruction belongs to. */
#define MOST_FUNCTIONS 4096
static struct { const char *name; uint64_t count; } function[MOST_FUNCTIONS];
static size_t known_functions;

static uint64_t *function_count(const char *name)
{
    name = name ? name : "(unknown)";
    for (size_t i = 0; i < known_functions; i++)
        if (!strcmp(function[i].name, name))
            return &function[i].count;
    if (known_functions == MOST_FUNCTIONS)
        return &function[MOST_FUNCTIONS - 1].count;
    function[known_functions].name = strdup(name);
    return &function[known_functions++].count;
}

/* The class of an aarch64 instruction, by the groups of the encoding. */
static int class_of(uint32_t word)
{
    if ((word & 0x0a000000) == 0x08000000) /* loads and stores */
    {
        uint32_t pair = (word & 0x38000000) == 0x28000000;
        uint32_t structure = (word & 0xbe000000) == 0x0c000000;
        uint32_t load = pair || structure ? word >> 22 & 1 : (word >> 22 & 3) != 0 && !((word >> 26 & 1) && (word >> 22 & 3) == 2);
        return load ? LOAD : STORE;
    }
    if ((word & 0x1c000000) == 0x14000000)
        return BRANCH;
    if ((word & 0x0e000000) == 0x0e000000)
    {
        uint32_t by_element = (word & 0xbf00f400) == 0x0f001000 && (word & 0x00800000); /* fmla, vector by element */
        uint32_t whole = (word & 0xbfa0fc00) == 0x0e20cc00;                              /* fmla, vector */
        uint32_t multiply = (word & 0xbfa0fc00) == 0x2e20dc00 || ((word & 0xbf00f400) == 0x0f009000 && (word & 0x00800000));
        return by_element || whole || multiply ? MULTIPLY_ADD : OTHER_VECTOR;
    }
    return OTHER;
}

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *block)
{
    uint64_t of[CLASSES] = {0};
    (void)id;
    of[ALL] = qemu_plugin_tb_n_insns(block);
    for (size_t i = 0; classes && i < of[ALL]; i++)
    {
        uint32_t word;
        memcpy(&word, qemu_plugin_insn_data(qemu_plugin_tb_get_insn(block, i)), sizeof word);
        of[class_of(word)]++;
    }
    if (functions)
    {
        uint64_t *count = function_count(qemu_plugin_insn_symbol(qemu_plugin_tb_get_insn(block, 0)));
        qemu_plugin_register_vcpu_tb_exec_inline(block, 0, count, of[ALL]);
    }
    for (int i = 0; i < CLASSES; i++)
        if (of[i])
            qemu_plugin_register_vcpu_tb_exec_inline(block, 0, &counts[i], of[i]);
}

static void finished(qemu_plugin_id_t id, void *data)
{
    (void)id, (void)data;
    for (int i = 0; i < (classes ? CLASSES : 1); i++)
        fprintf(stderr, "%s %llu\n", names[i], (unsigned long long)counts[i]);
    for (size_t i = 0; i < known_functions; i++)
        fprintf(stderr, "function %llu %s\n", (unsigned long long)function[i].count, function[i].name);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int argc, char **argv)
{
    (void)info;
    for (int i = 0; i < argc; i++)
    {
        classes |= !strcmp(argv[i], "classes=on");
        functions |= !strcmp(argv[i], "functions=on");
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, finished, NULL);
    return 0;
}
