/* A filter for OBS Studio that follows the face in the pictures of a camera. Other plugins and scripts read its coefficients by
 * the procedure `facewire_coefficient` of the filter, such as that of "jawOpen".
 *
 *     cc -shared -fPIC facewire_obs.c -o facewire_obs.so $(pkg-config --cflags --libs libobs facewire)
 *     install -D facewire_obs.so ~/.config/obs-studio/plugins/facewire_obs/bin/64bit/facewire_obs.so
 */
#include <obs-module.h>
#include <pthread.h>
#include <string.h>

#include "facewire.h"

OBS_DECLARE_MODULE()

struct filter {
    struct facewire_tracker *tracker;
    /* OBS gives pictures in one thread, and others may ask meanwhile. */
    pthread_mutex_t lock;
    struct facewire_face face;
    bool is_found;
    bool has_complained;
};

static const char *get_name(void *unused)
{
    UNUSED_PARAMETER(unused);
    return "facewire";
}

static void coefficient(void *data, calldata_t *call)
{
    struct filter *filter = data;
    const char *name = calldata_string(call, "name");
    size_t index = 0;
    while (index < FACEWIRE_BLENDSHAPES && (name == NULL || strcmp(facewire_blendshape(index), name) != 0))
        index++;
    pthread_mutex_lock(&filter->lock);
    bool is_found = filter->is_found && index < FACEWIRE_BLENDSHAPES;
    float value = is_found ? filter->face.coefficients[index] : 0;
    pthread_mutex_unlock(&filter->lock);
    calldata_set_bool(call, "is_found", is_found);
    calldata_set_float(call, "value", value);
}

static void *create(obs_data_t *settings, obs_source_t *source)
{
    UNUSED_PARAMETER(settings);
    char message[FACEWIRE_MESSAGE_BYTES];
    struct facewire_tracker *tracker = facewire_open(NULL, message, sizeof message);
    if (tracker == NULL) {
        blog(LOG_ERROR, "[facewire] %s", message);
        return NULL;
    }
    struct filter *filter = bzalloc(sizeof *filter);
    filter->tracker = tracker;
    pthread_mutex_init(&filter->lock, NULL);
    proc_handler_add(obs_source_get_proc_handler(source),
                     "void facewire_coefficient(in string name, out bool is_found, out float value)", coefficient, filter);
    return filter;
}

static void destroy(void *data)
{
    struct filter *filter = data;
    facewire_close(filter->tracker);
    pthread_mutex_destroy(&filter->lock);
    bfree(filter);
}

/* Describes a picture of OBS, whose planes have strides of their own. Returns false if facewire does not read its format. */
static bool describe(const struct obs_source_frame *frame, struct facewire_picture *picture)
{
    memset(picture, 0, sizeof *picture);
    picture->width = frame->width, picture->height = frame->height, picture->is_video_range = !frame->full_range;
    picture->data = frame->data[0], picture->stride = frame->linesize[0];
    picture->bytes = (size_t)frame->linesize[0] * frame->height;
    size_t rows_of_chroma = frame->height;
    switch (frame->format) {
    case VIDEO_FORMAT_NV12:
        picture->format = FACEWIRE_NV12, rows_of_chroma = (frame->height + 1) / 2;
        break;
    case VIDEO_FORMAT_I420:
        picture->format = FACEWIRE_I420, rows_of_chroma = (frame->height + 1) / 2;
        break;
    case VIDEO_FORMAT_I422:
        picture->format = FACEWIRE_I422;
        break;
    case VIDEO_FORMAT_I444:
        picture->format = FACEWIRE_I444;
        break;
    case VIDEO_FORMAT_YUY2:
        picture->format = FACEWIRE_YUYV;
        return !frame->flip;
    case VIDEO_FORMAT_BGRA:
    case VIDEO_FORMAT_BGRX:
        picture->format = FACEWIRE_BGRA;
        return !frame->flip;
    default:
        return false;
    }
    picture->chroma[0] = frame->data[1], picture->chroma[1] = frame->data[2];
    picture->chroma_stride = frame->linesize[1], picture->chroma_bytes = frame->linesize[1] * rows_of_chroma;
    return !frame->flip;
}

/* Follows the face, and leaves the picture as it is. */
static struct obs_source_frame *filter_video(void *data, struct obs_source_frame *frame)
{
    struct filter *filter = data;
    struct facewire_picture picture;
    struct facewire_face face;
    const char *message = "pictures of this format are not read";
    int found = -1;
    if (describe(frame, &picture)) {
        found = facewire_process(filter->tracker, &picture, frame->timestamp / 1000, &face, 1);
        message = facewire_message(filter->tracker);
    }
    if (found < 0 && !filter->has_complained) {
        blog(LOG_WARNING, "[facewire] %s", message);
        filter->has_complained = true;
    }
    pthread_mutex_lock(&filter->lock);
    filter->is_found = found == 1;
    if (filter->is_found)
        filter->face = face;
    pthread_mutex_unlock(&filter->lock);
    return frame;
}

static struct obs_source_info facewire_filter = {
    .id = "facewire_filter",
    .type = OBS_SOURCE_TYPE_FILTER,
    .output_flags = OBS_SOURCE_ASYNC_VIDEO,
    .get_name = get_name,
    .create = create,
    .destroy = destroy,
    .filter_video = filter_video,
};

bool obs_module_load(void)
{
    obs_register_source(&facewire_filter);
    return true;
}
