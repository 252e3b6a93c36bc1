/* An extension of Godot with the class FacewireTracker, which follows the face in pictures.
 *
 *     cc -shared -fPIC facewire_godot.c -o libfacewire_godot.so $(pkg-config --cflags --libs facewire)
 *
 * Beside the library, the project has a file facewire.gdextension:
 *
 *     [configuration]
 *     entry_symbol = "facewire_godot"
 *     compatibility_minimum = "4.2"
 *     [libraries]
 *     linux.x86_64 = "res://libfacewire_godot.so"
 *
 * A script, with a picture of the format Image.FORMAT_RGB8:
 *
 *     var tracker = FacewireTracker.new()
 *     if tracker.process(image.get_data(), image.get_width(), image.get_height(), Time.get_ticks_usec()):
 *         print(tracker.coefficient("jawOpen"))
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "facewire.h"
#include "godot.h"

enum { MOST_ARGUMENTS = 4 };

/* Functions of Godot. */
static struct {
    void (*new_name)(struct godot_name *name, const char *text, uint8_t is_static);
    void (*new_string)(struct godot_string *string, const char *text);
    int64_t (*string_to_utf8)(const struct godot_string *string, char *text, int64_t bytes);
    const uint8_t *(*byte_at)(const struct godot_bytes *bytes, int64_t index);
    uint32_t (*type_of)(const struct godot_variant *variant);
    uint8_t (*can_convert)(enum godot_type from, enum godot_type to);
    godot_convert (*from_variant)(enum godot_type type);
    godot_convert (*to_variant)(enum godot_type type);
    godot_destroy (*destructor)(enum godot_type type);
    godot_builtin_method (*builtin_method)(enum godot_type type, const struct godot_name *name, int64_t hash);
    void *(*new_object)(const struct godot_name *class);
    void (*set_instance)(void *object, const struct godot_name *class, void *instance);
    void (*register_class)(void *library, const struct godot_name *name, const struct godot_name *parent,
                           const struct godot_class *class);
    void (*register_method)(void *library, const struct godot_name *class, const struct godot_method *method);
    void (*unregister_class)(void *library, const struct godot_name *name);
    godot_builtin_method size_of_bytes;
} godot;

static void *library;
static struct godot_name class_name, parent_name, no_name;
static struct godot_string no_text;

struct instance {
    struct facewire_tracker *tracker;
    struct facewire_face face;
    uint8_t is_found;
};

static void *create(void *data)
{
    (void)data;
    struct instance *instance = calloc(1, sizeof *instance);
    char message[FACEWIRE_MESSAGE_BYTES];
    void *object = godot.new_object(&parent_name);
    instance->tracker = facewire_open(NULL, message, sizeof message);
    if (instance->tracker == NULL)
        fprintf(stderr, "facewire: %s\n", message);
    godot.set_instance(object, &class_name, instance);
    return object;
}

static void destroy(void *data, void *instance)
{
    (void)data;
    facewire_close(((struct instance *)instance)->tracker);
    free(instance);
}

/* process(picture: PackedByteArray, width: int, height: int, time_us: int) -> bool */
static void process(struct instance *instance, const void *const *arguments, void *result)
{
    const struct godot_bytes *bytes = arguments[0];
    const int64_t width = *(const int64_t *)arguments[1], height = *(const int64_t *)arguments[2];
    const int64_t time_us = *(const int64_t *)arguments[3];
    int64_t size = 0;
    godot.size_of_bytes((void *)bytes, NULL, &size, 0);
    struct facewire_picture picture = {0};
    picture.format = FACEWIRE_RGB, picture.bytes = (size_t)size;
    picture.width = width > 0 && width <= UINT32_MAX ? (uint32_t)width : 0;
    picture.height = height > 0 && height <= UINT32_MAX ? (uint32_t)height : 0;
    picture.data = size > 0 ? godot.byte_at(bytes, 0) : NULL;
    int found = facewire_process(instance->tracker, &picture, time_us > 0 ? (uint64_t)time_us : 0, &instance->face, 1);
    if (found < 0)
        fprintf(stderr, "facewire: %s\n", facewire_message(instance->tracker));
    *(uint8_t *)result = instance->is_found = found == 1;
}

/* coefficient(name: String) -> float */
static void coefficient(struct instance *instance, const void *const *arguments, void *result)
{
    char name[64];
    int64_t length = godot.string_to_utf8(arguments[0], name, sizeof name - 1);
    name[length > 0 && length < (int64_t)sizeof name ? length : 0] = 0;
    *(double *)result = 0;
    for (size_t i = 0; instance->is_found && i < FACEWIRE_BLENDSHAPES; i++)
        if (strcmp(name, facewire_blendshape(i)) == 0)
            *(double *)result = instance->face.coefficients[i];
}

static const struct method {
    const char *name;
    void (*run)(struct instance *instance, const void *const *arguments, void *result);
    enum godot_type result;
    uint32_t count;
    enum godot_type types[MOST_ARGUMENTS];
    const char *names[MOST_ARGUMENTS];
} METHODS[] = {
    {"process", process, GODOT_BOOL, 4, {GODOT_BYTES, GODOT_INT, GODOT_INT, GODOT_INT}, {"picture", "width", "height", "time_us"}},
    {"coefficient", coefficient, GODOT_FLOAT, 1, {GODOT_STRING}, {"name"}},
};

static void call_typed(void *data, void *instance, const void *const *arguments, void *result)
{
    ((const struct method *)data)->run(instance, arguments, result);
}

/* Whether the arguments are those of the method, or Godot converts them as for its own methods, such as a float to an int. */
static int are_right(const struct method *method, const struct godot_variant *const *arguments, int64_t count,
                     struct godot_call_error *error)
{
    *error = (struct godot_call_error){GODOT_CALLED, 0, 0};
    if (count != method->count) {
        error->fault = count < method->count ? GODOT_TOO_FEW_ARGUMENTS : GODOT_TOO_MANY_ARGUMENTS;
        error->expected = (int32_t)method->count;
        return 0;
    }
    for (int32_t i = 0; i < count; i++) {
        if (!godot.can_convert(godot.type_of(arguments[i]), method->types[i])) {
            *error = (struct godot_call_error){GODOT_WRONG_ARGUMENT, i, (int32_t)method->types[i]};
            return 0;
        }
    }
    return 1;
}

static void call(void *data, void *instance, const struct godot_variant *const *arguments, int64_t count,
                 struct godot_variant *result, struct godot_call_error *error)
{
    const struct method *method = data;
    union {
        int64_t number;
        struct godot_string string;
        struct godot_bytes bytes;
    } values[MOST_ARGUMENTS];
    union {
        uint8_t flag;
        double number;
    } returned;
    const void *pointers[MOST_ARGUMENTS];
    if (!are_right(method, arguments, count, error))
        return;
    for (int64_t i = 0; i < count; i++) {
        godot.from_variant(method->types[i])(&values[i], (void *)arguments[i]);
        pointers[i] = &values[i];
    }
    method->run(instance, pointers, &returned);
    godot.to_variant(method->result)(result, &returned);
    for (int64_t i = 0; i < count; i++)
        if (method->types[i] == GODOT_STRING || method->types[i] == GODOT_BYTES)
            godot.destructor(method->types[i])(&values[i]);
}

static struct godot_property property(enum godot_type type, struct godot_name *name)
{
    return (struct godot_property){type, name, &no_name, 0, &no_text, GODOT_USUAL_PROPERTY};
}

/* Names that Godot copies may not refer to texts of this library, which it may close before it ends. */
static void name(struct godot_name *name, const char *text)
{
    godot.new_name(name, text, 0);
}

static void register_method(const struct method *method)
{
    struct godot_name own_name, names[MOST_ARGUMENTS];
    struct godot_property result = property(method->result, &no_name), arguments[MOST_ARGUMENTS];
    uint32_t metadata[MOST_ARGUMENTS] = {0};
    name(&own_name, method->name);
    for (uint32_t i = 0; i < method->count; i++) {
        name(&names[i], method->names[i]);
        arguments[i] = property(method->types[i], &names[i]);
    }
    struct godot_method described = {0};
    described.name = &own_name, described.data = (void *)method, described.flags = GODOT_USUAL_METHOD;
    described.call = call, described.call_typed = call_typed;
    described.has_result = 1, described.result = &result;
    described.argument_count = method->count, described.arguments = arguments, described.arguments_metadata = metadata;
    godot.register_method(library, &class_name, &described);
    for (uint32_t i = 0; i < method->count; i++)
        godot.destructor(GODOT_NAME)(&names[i]);
    godot.destructor(GODOT_NAME)(&own_name);
}

static void begin(void *data, enum godot_level level)
{
    (void)data;
    if (level != GODOT_SCENE)
        return;
    struct godot_name size;
    name(&class_name, "FacewireTracker");
    name(&parent_name, "RefCounted");
    name(&no_name, "");
    name(&size, "size");
    godot.new_string(&no_text, "");
    /* The number is Godot's hash of the method's signature. */
    godot.size_of_bytes = godot.builtin_method(GODOT_BYTES, &size, 3173160232);
    godot.destructor(GODOT_NAME)(&size);
    if (!godot.size_of_bytes)
        return; /* another Godot, whose method differs: the class is not there */
    struct godot_class class = {0};
    class.is_exposed = 1, class.create = create, class.destroy = destroy;
    godot.register_class(library, &class_name, &parent_name, &class);
    for (size_t i = 0; i < sizeof METHODS / sizeof METHODS[0]; i++)
        register_method(&METHODS[i]);
}

static void end(void *data, enum godot_level level)
{
    (void)data;
    if (level != GODOT_SCENE)
        return;
    godot.unregister_class(library, &class_name);
    godot.destructor(GODOT_NAME)(&class_name);
    godot.destructor(GODOT_NAME)(&parent_name);
    godot.destructor(GODOT_NAME)(&no_name);
    godot.destructor(GODOT_STRING)(&no_text);
}

/* Godot calls this when it has loaded the library. */
uint8_t facewire_godot(godot_find find, void *of_library, struct godot_initialization *initialization)
{
    const struct {
        void *function;
        const char *name;
    } wanted[] = {
        {&godot.new_name, "string_name_new_with_latin1_chars"},
        {&godot.new_string, "string_new_with_latin1_chars"},
        {&godot.string_to_utf8, "string_to_utf8_chars"},
        {&godot.byte_at, "packed_byte_array_operator_index_const"},
        {&godot.type_of, "variant_get_type"},
        {&godot.can_convert, "variant_can_convert_strict"},
        {&godot.from_variant, "get_variant_to_type_constructor"},
        {&godot.to_variant, "get_variant_from_type_constructor"},
        {&godot.destructor, "variant_get_ptr_destructor"},
        {&godot.builtin_method, "variant_get_ptr_builtin_method"},
        {&godot.new_object, "classdb_construct_object"},
        {&godot.set_instance, "object_set_instance"},
        {&godot.register_class, "classdb_register_extension_class2"},
        {&godot.register_method, "classdb_register_extension_class_method"},
        {&godot.unregister_class, "classdb_unregister_extension_class"},
    };
    for (size_t i = 0; i < sizeof wanted / sizeof wanted[0]; i++) {
        godot_function found = find(wanted[i].name);
        if (found == NULL)
            return 0;
        memcpy(wanted[i].function, &found, sizeof found);
    }
    library = of_library;
    initialization->least_level = GODOT_SCENE;
    initialization->begin = begin, initialization->end = end;
    return 1;
}
