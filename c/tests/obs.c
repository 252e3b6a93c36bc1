/* Stands in for OBS Studio: loads a plugin, and gives its filter the pictures of a raw video of 640 x 480 pixels (4:2:2 planes,
 * full range), as NV12 and as I420 in planes whose rows have padding. Prints what the procedure of the filter says of jawOpen.
 * What procedures and their values need is libobs's own.
 *
 *     obs PLUGIN FILM.i422
 */
#include <assert.h>
#include <dlfcn.h>
#include <obs-module.h>
#include <stdio.h>
#include <string.h>

enum { WIDTH = 640, HEIGHT = 480, STRIDE = 704, FILM_BYTES = WIDTH * HEIGHT * 2 };

static struct obs_source_info filter;

void obs_register_source_s(const struct obs_source_info *info, size_t size)
{
    assert(size == sizeof filter);
    filter = *info;
}

/* The source of this program is its handler of procedures. */
proc_handler_t *obs_source_get_proc_handler(const obs_source_t *source)
{
    return (proc_handler_t *)source;
}

static void *function(void *plugin, const char *name)
{
    void *found = dlsym(plugin, name);
    assert(found != NULL);
    return found;
}

/* Writes a picture of the video into planes of this format. */
static void fill(struct obs_source_frame *frame, enum video_format format, const uint8_t *film)
{
    static uint8_t planes[3][STRIDE * HEIGHT];
    const uint8_t *cb = film + WIDTH * HEIGHT, *cr = cb + WIDTH / 2 * HEIGHT;
    memset(planes, 0x55, sizeof planes);
    for (int row = 0; row < HEIGHT; row++)
        memcpy(planes[0] + row * STRIDE, film + row * WIDTH, WIDTH);
    for (int i = 0; i < WIDTH / 2 * HEIGHT / 2; i++) {
        int row = i / (WIDTH / 2), column = i % (WIDTH / 2), from = 2 * row * (WIDTH / 2) + column;
        if (format == VIDEO_FORMAT_NV12) {
            planes[1][row * STRIDE + 2 * column] = cb[from];
            planes[1][row * STRIDE + 2 * column + 1] = cr[from];
        } else {
            planes[1][row * STRIDE / 2 + column] = cb[from];
            planes[2][row * STRIDE / 2 + column] = cr[from];
        }
    }
    frame->data[0] = planes[0], frame->data[1] = planes[1], frame->data[2] = format == VIDEO_FORMAT_NV12 ? NULL : planes[2];
    frame->linesize[0] = STRIDE, frame->linesize[1] = format == VIDEO_FORMAT_NV12 ? STRIDE : STRIDE / 2;
    frame->linesize[2] = format == VIDEO_FORMAT_NV12 ? 0 : STRIDE / 2;
    frame->width = WIDTH, frame->height = HEIGHT, frame->format = format, frame->full_range = true;
}

static void follow(enum video_format format, const char *path)
{
    static uint8_t picture[FILM_BYTES];
    proc_handler_t *procedures = proc_handler_create();
    void *data = filter.create(NULL, (obs_source_t *)procedures);
    FILE *film = fopen(path, "rb");
    assert(data != NULL && film != NULL);
    for (uint64_t number = 0; fread(picture, 1, sizeof picture, film) == sizeof picture; number++) {
        struct obs_source_frame frame = {0};
        fill(&frame, format, picture);
        frame.timestamp = number * 1000000000 / 30;
        assert(filter.filter_video(data, &frame) == &frame);
        uint8_t stack[256];
        calldata_t call;
        calldata_init_fixed(&call, stack, sizeof stack);
        calldata_set_string(&call, "name", "jawOpen");
        assert(proc_handler_call(procedures, "facewire_coefficient", &call));
        if (calldata_bool(&call, "is_found"))
            printf("%s %.4f\n", get_video_format_name(format), calldata_float(&call, "value"));
    }
    fclose(film);
    filter.destroy(data);
    proc_handler_destroy(procedures);
}

int main(int argc, char **argv)
{
    assert(argc == 3);
    void *plugin = dlopen(argv[1], RTLD_NOW);
    if (plugin == NULL)
        fprintf(stderr, "%s\n", dlerror());
    assert(plugin != NULL);
    ((void (*)(obs_module_t *))function(plugin, "obs_module_set_pointer"))(NULL);
    assert(((uint32_t(*)(void))function(plugin, "obs_module_ver"))() == LIBOBS_API_VER);
    assert(((bool (*)(void))function(plugin, "obs_module_load"))());
    assert(strcmp(filter.id, "facewire_filter") == 0 && filter.type == OBS_SOURCE_TYPE_FILTER);
    assert(strcmp(filter.get_name(NULL), "facewire") == 0);
    follow(VIDEO_FORMAT_NV12, argv[2]);
    follow(VIDEO_FORMAT_I420, argv[2]);
    return 0;
}
