/* What facewire_godot.c needs of Godot's interface for extensions (Godot 4.2 and later, 64-bit systems). Godot gives each function by
 * its name, and counts on the order of the fields. Fields that the extension leaves empty have no types of their own. */
#ifndef GODOT_H
#define GODOT_H

#include <stdint.h>

/* Values of Godot, whose contents are its own. */
struct godot_name {
    uint64_t content;
};
struct godot_string {
    uint64_t content;
};
struct godot_bytes {
    uint64_t content[2];
};
struct godot_variant {
    uint64_t content[3];
};

enum godot_type { GODOT_NIL = 0, GODOT_BOOL = 1, GODOT_INT = 2, GODOT_FLOAT = 3, GODOT_STRING = 4, GODOT_NAME = 21, GODOT_BYTES = 29 };

enum godot_level { GODOT_CORE, GODOT_SERVERS, GODOT_SCENE, GODOT_EDITOR };

struct godot_initialization {
    enum godot_level least_level;
    void *data;
    void (*begin)(void *data, enum godot_level level);
    void (*end)(void *data, enum godot_level level);
};

enum godot_fault { GODOT_CALLED = 0, GODOT_WRONG_ARGUMENT = 2, GODOT_TOO_MANY_ARGUMENTS = 3, GODOT_TOO_FEW_ARGUMENTS = 4 };

struct godot_call_error {
    enum godot_fault fault;
    int32_t argument;
    int32_t expected;
};

typedef void (*godot_function)(void);
typedef godot_function (*godot_find)(const char *name);
typedef void (*godot_convert)(void *to, void *from);
typedef void (*godot_destroy)(void *value);
typedef void (*godot_builtin_method)(void *value, const void *const *arguments, void *result, int count);

struct godot_class {
    uint8_t is_virtual;
    uint8_t is_abstract;
    uint8_t is_exposed;
    godot_function of_properties[7];
    godot_function notification;
    godot_function to_string;
    godot_function reference;
    godot_function unreference;
    void *(*create)(void *data);
    void (*destroy)(void *data, void *instance);
    godot_function recreate;
    godot_function of_virtual_methods[3];
    godot_function resource_id;
    void *data;
};

/* A parameter or what a method returns. */
struct godot_property {
    enum godot_type type;
    struct godot_name *name;
    struct godot_name *class_name;
    uint32_t hint;
    struct godot_string *hint_text;
    uint32_t usage;
};

enum { GODOT_USUAL_PROPERTY = 6, GODOT_USUAL_METHOD = 1 };

struct godot_method {
    struct godot_name *name;
    void *data;
    /* A call with variants, as by scripts without types. */
    void (*call)(void *data, void *instance, const struct godot_variant *const *arguments, int64_t count,
                 struct godot_variant *result, struct godot_call_error *error);
    /* A call with pointers to values of the declared types. */
    void (*call_typed)(void *data, void *instance, const void *const *arguments, void *result);
    uint32_t flags;
    uint8_t has_result;
    struct godot_property *result;
    uint32_t result_metadata;
    uint32_t argument_count;
    struct godot_property *arguments;
    uint32_t *arguments_metadata;
    uint32_t default_count;
    struct godot_variant **defaults;
};

#endif
