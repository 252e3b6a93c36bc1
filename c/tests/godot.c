/* Stands in for Godot: loads an extension, makes an object of its class, and calls its methods with the pictures of a raw video
 * of 640 x 480 pixels (4:2:2 planes, full range), by turns as a script with types and as one without. Prints jawOpen of each
 * picture.
 *
 *     godot EXTENSION FILM.i422
 */
#include <assert.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../examples/godot.h"

enum { WIDTH = 640, HEIGHT = 480, BYTES = WIDTH * HEIGHT * 3, FILM_BYTES = WIDTH * HEIGHT * 2 };

/* Names and strings are pointers to texts of their own, arrays have a pointer and a size, variants a type and a value. */
static struct {
    struct godot_class class;
    struct godot_method methods[8];
    char method_names[8][32];
    size_t method_count;
    void *instance;
    int alive;
} registered;

/* Copies what Godot owns, and counts it until `forget` gives it back. */
static uint64_t keep(const void *contents, size_t bytes)
{
    registered.alive++;
    return (uint64_t)(uintptr_t)memcpy(malloc(bytes), contents, bytes);
}

static void new_name(struct godot_name *name, const char *text, uint8_t is_static)
{
    assert(!is_static);
    name->content = keep(text, strlen(text) + 1);
}

static void new_string(struct godot_string *string, const char *text)
{
    string->content = keep(text, strlen(text) + 1);
}

static const char *text_of(uint64_t content)
{
    return (const char *)(uintptr_t)content;
}

static int64_t string_to_utf8(const struct godot_string *string, char *text, int64_t bytes)
{
    int64_t length = (int64_t)strlen(text_of(string->content));
    memcpy(text, text_of(string->content), (size_t)(length < bytes ? length : bytes));
    return length;
}

static const uint8_t *byte_at(const struct godot_bytes *bytes, int64_t index)
{
    assert(index < (int64_t)bytes->content[1]);
    return (const uint8_t *)(uintptr_t)bytes->content[0] + index;
}

static void size_of_bytes(void *value, const void *const *arguments, void *result, int count)
{
    assert(arguments == NULL && count == 0);
    *(int64_t *)result = (int64_t)((struct godot_bytes *)value)->content[1];
}

static godot_builtin_method builtin_method(enum godot_type type, const struct godot_name *name, int64_t hash)
{
    assert(type == GODOT_BYTES && strcmp(text_of(name->content), "size") == 0 && hash == 3173160232);
    return size_of_bytes;
}

static uint32_t type_of(const struct godot_variant *variant)
{
    return (uint32_t)variant->content[0];
}

/* Of what Godot converts, what the calls below need. */
static uint8_t can_convert(enum godot_type from, enum godot_type to)
{
    return from == to || (from == GODOT_FLOAT && to == GODOT_INT) || (from == GODOT_NAME && to == GODOT_STRING);
}

static struct godot_variant variant(enum godot_type type, const void *value, size_t bytes)
{
    struct godot_variant made = {{type, 0, 0}};
    memcpy(&made.content[1], value, bytes);
    return made;
}

static void to_bool(void *to, void *from)
{
    *(struct godot_variant *)to = variant(GODOT_BOOL, from, 1);
}

static void to_float(void *to, void *from)
{
    *(struct godot_variant *)to = variant(GODOT_FLOAT, from, sizeof(double));
}

static godot_convert to_variant(enum godot_type type)
{
    assert(type == GODOT_BOOL || type == GODOT_FLOAT);
    return type == GODOT_BOOL ? to_bool : to_float;
}

static void from_bytes(void *to, void *from)
{
    struct godot_variant *of = from;
    struct godot_bytes *bytes = to;
    bytes->content[0] = keep(text_of(of->content[1]), of->content[2]);
    bytes->content[1] = of->content[2];
}

static void from_string(void *to, void *from)
{
    new_string(to, text_of(((struct godot_variant *)from)->content[1]));
}

static void from_int(void *to, void *from)
{
    const struct godot_variant *of = from;
    double number;
    memcpy(&number, &of->content[1], sizeof number);
    *(int64_t *)to = type_of(of) == GODOT_FLOAT ? (int64_t)number : (int64_t)of->content[1];
}

static godot_convert from_variant(enum godot_type type)
{
    assert(type == GODOT_BYTES || type == GODOT_STRING || type == GODOT_INT);
    return type == GODOT_BYTES ? from_bytes : type == GODOT_STRING ? from_string : from_int;
}

/* The first word of each is the pointer. */
static void forget(void *value)
{
    free((void *)(uintptr_t)((struct godot_string *)value)->content);
    registered.alive--;
}

static godot_destroy destructor(enum godot_type type)
{
    assert(type == GODOT_BYTES || type == GODOT_STRING || type == GODOT_NAME);
    return forget;
}

static void *new_object(const struct godot_name *class)
{
    assert(strcmp(text_of(class->content), "RefCounted") == 0);
    return &registered;
}

static void set_instance(void *object, const struct godot_name *class, void *instance)
{
    assert(object == &registered && strcmp(text_of(class->content), "FacewireTracker") == 0);
    registered.instance = instance;
}

static void register_class(void *library, const struct godot_name *name, const struct godot_name *parent,
                           const struct godot_class *class)
{
    assert(library == &registered && strcmp(text_of(name->content), "FacewireTracker") == 0);
    assert(strcmp(text_of(parent->content), "RefCounted") == 0 && class->is_exposed && !class->is_virtual);
    registered.class = *class;
}

static void register_method(void *library, const struct godot_name *class, const struct godot_method *method)
{
    assert(library == &registered && strcmp(text_of(class->content), "FacewireTracker") == 0);
    assert(method->has_result && method->result->type != GODOT_NIL && method->default_count == 0);
    for (uint32_t i = 0; i < method->argument_count; i++)
        assert(*text_of(method->arguments[i].name->content) != 0 && method->arguments[i].hint_text != NULL);
    strcpy(registered.method_names[registered.method_count], text_of(method->name->content));
    registered.methods[registered.method_count++] = *method;
}

static void unregister_class(void *library, const struct godot_name *name)
{
    assert(library == &registered && strcmp(text_of(name->content), "FacewireTracker") == 0);
    registered.method_count = 0;
}

static godot_function find(const char *name)
{
    static const struct {
        const char *name;
        godot_function function;
    } KNOWN[] = {
        {"string_name_new_with_latin1_chars", (godot_function)new_name},
        {"string_new_with_latin1_chars", (godot_function)new_string},
        {"string_to_utf8_chars", (godot_function)string_to_utf8},
        {"packed_byte_array_operator_index_const", (godot_function)byte_at},
        {"variant_get_type", (godot_function)type_of},
        {"variant_can_convert_strict", (godot_function)can_convert},
        {"get_variant_to_type_constructor", (godot_function)from_variant},
        {"get_variant_from_type_constructor", (godot_function)to_variant},
        {"variant_get_ptr_destructor", (godot_function)destructor},
        {"variant_get_ptr_builtin_method", (godot_function)builtin_method},
        {"classdb_construct_object", (godot_function)new_object},
        {"object_set_instance", (godot_function)set_instance},
        {"classdb_register_extension_class2", (godot_function)register_class},
        {"classdb_register_extension_class_method", (godot_function)register_method},
        {"classdb_unregister_extension_class", (godot_function)unregister_class},
    };
    for (size_t i = 0; i < sizeof KNOWN / sizeof KNOWN[0]; i++)
        if (strcmp(KNOWN[i].name, name) == 0)
            return KNOWN[i].function;
    return NULL;
}

static const struct godot_method *method(const char *name)
{
    for (size_t i = 0; i < registered.method_count; i++)
        if (strcmp(registered.method_names[i], name) == 0)
            return &registered.methods[i];
    assert(!"there is no such method");
    return NULL;
}

/* Calls a method as a script without types does. */
static struct godot_variant call(const char *name, const struct godot_variant *arguments, int64_t count, enum godot_fault fault)
{
    const struct godot_variant *pointers[4] = {&arguments[0], &arguments[1], &arguments[2], &arguments[3]};
    struct godot_variant result = {{GODOT_NIL, 0, 0}};
    struct godot_call_error error;
    method(name)->call(method(name)->data, registered.instance, pointers, count, &result, &error);
    assert(error.fault == fault && (result.content[0] != GODOT_NIL) == (fault == GODOT_CALLED));
    return result;
}

static double with_types(const uint8_t *picture, int64_t time_us)
{
    const struct godot_bytes bytes = {{(uint64_t)(uintptr_t)picture, BYTES}};
    const int64_t width = WIDTH, height = HEIGHT;
    const struct godot_string name = {(uint64_t)(uintptr_t)"jawOpen"};
    uint8_t is_found = 0;
    double value = 0;
    method("process")->call_typed(method("process")->data, registered.instance,
                                  (const void *const[]){&bytes, &width, &height, &time_us}, &is_found);
    method("coefficient")->call_typed(method("coefficient")->data, registered.instance, (const void *const[]){&name}, &value);
    return is_found ? value : -1;
}

static double without_types(const uint8_t *picture, int64_t time_us)
{
    /* A division makes a float of a time in a script. */
    const double time = (double)time_us;
    struct godot_variant arguments[4] = {{{GODOT_BYTES, (uint64_t)(uintptr_t)picture, BYTES}},
                                         {{GODOT_INT, WIDTH, 0}},
                                         {{GODOT_INT, HEIGHT, 0}},
                                         variant(GODOT_FLOAT, &time, sizeof time)};
    struct godot_variant name[4] = {{{GODOT_STRING, (uint64_t)(uintptr_t)"jawOpen", 0}}};
    double value;
    if (call("process", arguments, 4, GODOT_CALLED).content[1] != 1)
        return -1;
    struct godot_variant result = call("coefficient", name, 1, GODOT_CALLED);
    memcpy(&value, &result.content[1], sizeof value);
    name[0].content[0] = GODOT_NAME;
    assert(call("coefficient", name, 1, GODOT_CALLED).content[1] == result.content[1]);
    call("coefficient", name, 0, GODOT_TOO_FEW_ARGUMENTS);
    call("coefficient", name, 2, GODOT_TOO_MANY_ARGUMENTS);
    call("coefficient", &arguments[1], 1, GODOT_WRONG_ARGUMENT);
    return value;
}

static uint8_t sample(double value)
{
    return value < 0 ? 0 : value > 255 ? 255 : (uint8_t)(value + 0.5);
}

static void to_rgb(const uint8_t *film, uint8_t *picture)
{
    const uint8_t *cb = film + WIDTH * HEIGHT, *cr = cb + WIDTH / 2 * HEIGHT;
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        picture[3 * i] = sample(film[i] + 1.402 * (cr[i / 2] - 128));
        picture[3 * i + 1] = sample(film[i] - 0.344136 * (cb[i / 2] - 128) - 0.714136 * (cr[i / 2] - 128));
        picture[3 * i + 2] = sample(film[i] + 1.772 * (cb[i / 2] - 128));
    }
}

int main(int argc, char **argv)
{
    static uint8_t picture[BYTES], planes[FILM_BYTES];
    assert(argc == 3);
    void *extension = dlopen(argv[1], RTLD_NOW);
    if (extension == NULL)
        fprintf(stderr, "%s\n", dlerror());
    assert(extension != NULL);
    uint8_t (*entry)(godot_find, void *, struct godot_initialization *) = dlsym(extension, "facewire_godot");
    struct godot_initialization initialization;
    assert(entry != NULL && entry(find, &registered, &initialization) && initialization.least_level == GODOT_SCENE);
    for (enum godot_level level = GODOT_CORE; level <= GODOT_EDITOR; level++)
        initialization.begin(initialization.data, level);
    assert(registered.method_count == 2 && registered.class.create(registered.class.data) == &registered);
    FILE *film = fopen(argv[2], "rb");
    assert(film != NULL);
    for (int64_t number = 0; fread(planes, 1, FILM_BYTES, film) == FILM_BYTES; number++) {
        to_rgb(planes, picture);
        double (*ways[2])(const uint8_t *, int64_t) = {with_types, without_types};
        double value = ways[number % 2](picture, number * 1000000 / 30);
        if (value >= 0)
            printf("RGB %.4f\n", value);
    }
    fclose(film);
    registered.class.destroy(registered.class.data, registered.instance);
    for (enum godot_level level = GODOT_EDITOR; (int)level >= GODOT_CORE; level--)
        initialization.end(initialization.data, level);
    assert(registered.method_count == 0 && registered.alive == 0);
    return 0;
}
