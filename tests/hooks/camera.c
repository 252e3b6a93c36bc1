/* Simulated V4L2 cameras that behave as a test describes them. The program under test needs no device.
 *
 * A test preloads this library into a program and names a folder in CAMERAS. The program then finds the folder's
 * `dev/video0` to `dev/video9`, `dev/v4l`, `sys/class/video4linux` and `run/facewire-camera` under these names in `/`, and no
 * camera of this machine. Each file `dev/videoN` is a camera, and its text describes the camera (camera_description.h). Links below
 * `dev/v4l` lead to them. What a program asks a camera for is written to `calls/videoN`.
 *
 * A test may rewrite the text of a file at any time, with the file locked by flock(): the camera then goes on by the new
 * text. A file that is removed or replaced is a camera that was unplugged.
 *
 * The cameras have no thread. On each call, the library puts the frames that have become due since the last call, by
 * the monotonic clock, into queued buffers, or drops them if no buffer is queued, as a driver does.
 *
 * Limits: it knows only the V4L2 calls that capture by mapped buffers, and replaces only the functions that Rust's
 * standard library and the crates v4l and v4l2r call, not every function that takes a path.
 *
 * Build: cc -O1 -shared -fPIC -o camera.so camera.c -ldl */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/sysmacros.h>
#include <time.h>

#include "camera_description.h"

/* The function of this name that this library replaces. */
#define HIDDEN(function)                                                                                               \
    ({                                                                                                                 \
        static __typeof__(&function) hidden;                                                                           \
        if (!hidden)                                                                                                   \
            hidden = (__typeof__(&function))dlsym(RTLD_NEXT, #function);                                               \
        hidden;                                                                                                        \
    })

#define MOST_NODES 10
#define MOST_OPEN 16
#define MOST_BUFFERS 8
#define VIDEO_MAJOR 81
/* Distance between the offsets at which buffers are mapped: more than a picture of 4096x4096 pixels takes. */
#define BUFFER_OFFSET 0x10000000u
/* How soon a program that waits for a frame notices that the description has changed, microseconds. */
#define LOOK_AGAIN_US 2000

struct buffer {
    unsigned char *memory;
    uint32_t used;
    uint32_t flags;
    uint32_t number;
    int64_t time_us;
};

/* The numbers of buffers, oldest first. */
struct queue {
    uint32_t count;
    uint32_t buffers[MOST_BUFFERS];
};

/* A camera as its file describes it, shared by all descriptors that have it open. */
struct node {
    char name[8];
    char text[MOST_TEXT];
    struct description is;
};

/* A camera that is open. */
struct camera {
    /* 0 while this place is free. */
    int descriptor;
    struct node *node;
    struct description *is;
    uint32_t format, width, height, stride, image_bytes;
    /* Seconds and frames. */
    uint32_t interval[2];
    struct buffer buffers[MOST_BUFFERS];
    uint32_t buffer_count;
    struct queue queued, filled;
    int is_streaming;
    int64_t begun_us, due_us, last_stamp_us;
    /* Frames since the stream began, lost ones included. */
    uint32_t frame;
};

static struct node nodes[MOST_NODES];
static struct camera cameras[MOST_OPEN];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

/* ---- Paths ---- */

static const char *folder(void)
{
    const char *folder = getenv("CAMERAS");
    return folder ? folder : "";
}

static int begins(const char *path, const char *beginning)
{
    return path && !strncmp(path, beginning, strlen(beginning));
}

static int is_ours(const char *path)
{
    return *folder() && (begins(path, "/dev/video") || begins(path, "/dev/v4l") ||
                         begins(path, "/sys/class/video4linux") || begins(path, "/run/facewire-camera") ||
                         (path && !strcmp(path, "/dev")));
}

/* Writes the path of the file that stands for `path`, and returns it. */
static const char *file_of(const char *path, char file[PATH_MAX])
{
    snprintf(file, PATH_MAX, "%s%s", folder(), path);
    return file;
}

/* ---- The description ---- */

static int64_t clock_us(clockid_t clock)
{
    struct timespec time;
    clock_gettime(clock, &time);
    return time.tv_sec * 1000000LL + time.tv_nsec / 1000;
}

/* Returns the node of this path, such as /dev/video0. */
static struct node *node_of(const char *path)
{
    unsigned number = (unsigned)atoi(path + strlen("/dev/video"));
    if (number >= MOST_NODES)
        abort();
    snprintf(nodes[number].name, sizeof nodes[number].name, "video%u", number);
    return &nodes[number];
}

/* Reads the description again if it has changed. */
static void look(struct camera *camera)
{
    char text[MOST_TEXT];
    flock(camera->descriptor, LOCK_SH);
    ssize_t bytes = pread(camera->descriptor, text, sizeof text - 1, 0);
    flock(camera->descriptor, LOCK_UN);
    text[bytes > 0 ? bytes : 0] = '\0';
    struct node *node = camera->node;
    if (!strcmp(text, node->text))
        return;
    strcpy(node->text, text);
    read_description(&node->is, text);
}

static int is_gone(const struct camera *camera)
{
    char path[64], file[PATH_MAX];
    struct stat named, open;
    snprintf(path, sizeof path, "/dev/%s", camera->node->name);
    return stat(file_of(path, file), &named) != 0 || fstat(camera->descriptor, &open) != 0 ||
           named.st_ino != open.st_ino;
}

/* Adds what the program has asked for to the camera's list of calls. */
__attribute__((format(printf, 2, 3))) static void note(const struct camera *camera, const char *format, ...)
{
    char path[64], file[PATH_MAX], line[128];
    snprintf(path, sizeof path, "/calls/%s", camera->node->name);
    va_list values;
    va_start(values, format);
    int bytes = vsnprintf(line, sizeof line, format, values);
    va_end(values);
    int calls = HIDDEN(open)(file_of(path, file), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0666);
    if (calls < 0 || write(calls, line, (size_t)bytes) != bytes)
        abort();
    HIDDEN(close)(calls);
}

/* Returns the error with which this call is to fail, or 0 if it is not to fail. */
static int failure(struct camera *camera, const char *call)
{
    for (uint32_t i = 0; i < camera->is->failure_count; i++) {
        struct failure *failure = &camera->is->failures[i];
        if (!strcmp(failure->call, call) && (++failure->calls == failure->nth || !failure->nth))
            return failure->error;
    }
    return 0;
}

/* ---- Formats, sizes and rates ---- */

static int is_multiplanar(const struct camera *camera)
{
    return (camera->is->device_capabilities & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0;
}

/* Whether the camera has buffers of this type. */
static int captures(const struct camera *camera, uint32_t type)
{
    if (is_multiplanar(camera))
        return type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
    return (camera->is->device_capabilities & V4L2_CAP_VIDEO_CAPTURE) && type == V4L2_BUF_TYPE_VIDEO_CAPTURE;
}

static int offers(const struct camera *camera, uint32_t format)
{
    for (uint32_t i = 0; i < camera->is->format_count; i++)
        if (camera->is->formats[i] == format)
            return 1;
    return 0;
}

static uint32_t between(uint32_t value, uint32_t least, uint32_t most)
{
    return value < least ? least : value > most ? most : value;
}

static void choose_size(struct camera *camera, uint32_t width, uint32_t height)
{
    const struct list *sizes = &camera->is->sizes;
    const uint32_t *chosen = sizes->pairs[0];
    int64_t wanted = (int64_t)width * height;
    for (uint32_t i = 1; sizes->listing == DISCRETE && i < sizes->count; i++) {
        const uint32_t *other = sizes->pairs[i];
        if (llabs((int64_t)other[0] * other[1] - wanted) < llabs((int64_t)chosen[0] * chosen[1] - wanted))
            chosen = other;
    }
    camera->width = chosen[0];
    camera->height = chosen[1];
    if (sizes->listing == STEPS || sizes->listing == CONTINUOUS) {
        camera->width = between(width, sizes->pairs[0][0], sizes->pairs[1][0]);
        camera->height = between(height, sizes->pairs[0][1], sizes->pairs[1][1]);
    }
    if (camera->is->granted_size[0]) {
        camera->width = camera->is->granted_size[0];
        camera->height = camera->is->granted_size[1];
    }
}

static uint32_t default_stride(uint32_t format, uint32_t width)
{
    switch (format) {
    case V4L2_PIX_FMT_YUYV:
    case V4L2_PIX_FMT_UYVY:
        return 2 * width;
    case V4L2_PIX_FMT_MJPEG:
    case V4L2_PIX_FMT_JPEG:
        return 0;
    default:
        return width;
    }
}

static uint32_t default_image_bytes(const struct camera *camera)
{
    switch (camera->format) {
    case V4L2_PIX_FMT_NV12:
    case V4L2_PIX_FMT_YUV420:
        return camera->stride * camera->height * 3 / 2;
    case V4L2_PIX_FMT_MJPEG:
    case V4L2_PIX_FMT_JPEG:
        return camera->width * camera->height * 2 + 65536;
    default:
        return camera->stride * camera->height;
    }
}

static void choose_format(struct camera *camera, uint32_t format, uint32_t width, uint32_t height)
{
    const struct description *is = camera->is;
    camera->format = is->granted_format ? is->granted_format : offers(camera, format) ? format : is->formats[0];
    choose_size(camera, width, height);
    camera->stride = is->stride ? is->stride : default_stride(camera->format, camera->width);
    camera->image_bytes = is->image_bytes ? is->image_bytes : default_image_bytes(camera);
}

static double seconds(const uint32_t interval[2])
{
    return (double)interval[0] / interval[1];
}

static void choose_interval(struct camera *camera, const uint32_t wanted[2])
{
    const struct list *intervals = &camera->is->intervals;
    const uint32_t *chosen = intervals->pairs[0];
    int has_wanted = wanted[0] && wanted[1];
    if (intervals->listing == DISCRETE) {
        for (uint32_t i = 1; has_wanted && i < intervals->count; i++) {
            double distance = seconds(intervals->pairs[i]) - seconds(wanted), least = seconds(chosen) - seconds(wanted);
            if (distance * distance < least * least)
                chosen = intervals->pairs[i];
        }
    } else if (intervals->listing != NOT_LISTED && has_wanted && seconds(wanted) > seconds(intervals->pairs[0])) {
        chosen = seconds(wanted) < seconds(intervals->pairs[1]) ? wanted : intervals->pairs[1];
    }
    if (camera->is->granted_interval[0])
        chosen = camera->is->granted_interval;
    camera->interval[0] = chosen[0];
    camera->interval[1] = chosen[1];
}

static int query_capabilities(struct camera *camera, struct v4l2_capability *answer)
{
    memset(answer, 0, sizeof *answer);
    memcpy(answer->card, camera->is->card, sizeof answer->card);
    memcpy(answer->driver, camera->is->driver, sizeof answer->driver);
    memcpy(answer->bus_info, camera->is->bus, sizeof answer->bus_info);
    answer->version = 0x60100;
    answer->capabilities = camera->is->capabilities;
    answer->device_caps = camera->is->device_capabilities;
    return 0;
}

static int list_format(struct camera *camera, struct v4l2_fmtdesc *format)
{
    if (!captures(camera, format->type) || format->index >= camera->is->format_count)
        return EINVAL;
    uint32_t fourcc = camera->is->formats[format->index];
    int is_jpeg = fourcc == V4L2_PIX_FMT_MJPEG || fourcc == V4L2_PIX_FMT_JPEG;
    format->pixelformat = fourcc;
    format->flags = is_jpeg ? V4L2_FMT_FLAG_COMPRESSED : 0;
    memset(format->description, 0, sizeof format->description);
    memcpy(format->description, &fourcc, sizeof fourcc);
    return 0;
}

static int list_size(struct camera *camera, struct v4l2_frmsizeenum *size)
{
    const struct list *sizes = &camera->is->sizes;
    if (sizes->listing == NOT_LISTED)
        return ENOTTY;
    if (!offers(camera, size->pixel_format) || size->index >= (sizes->listing == DISCRETE ? sizes->count : 1))
        return EINVAL;
    if (sizes->listing == DISCRETE) {
        size->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        size->discrete.width = sizes->pairs[size->index][0];
        size->discrete.height = sizes->pairs[size->index][1];
        return 0;
    }
    int has_steps = sizes->listing == STEPS;
    const uint32_t(*pairs)[2] = sizes->pairs;
    size->type = has_steps ? V4L2_FRMSIZE_TYPE_STEPWISE : V4L2_FRMSIZE_TYPE_CONTINUOUS;
    size->stepwise.min_width = pairs[0][0];
    size->stepwise.min_height = pairs[0][1];
    size->stepwise.max_width = pairs[1][0];
    size->stepwise.max_height = pairs[1][1];
    size->stepwise.step_width = has_steps ? pairs[2][0] : 1;
    size->stepwise.step_height = has_steps ? pairs[2][1] : 1;
    return 0;
}

static struct v4l2_fract fraction(const uint32_t pair[2])
{
    return (struct v4l2_fract){ .numerator = pair[0], .denominator = pair[1] };
}

static int list_interval(struct camera *camera, struct v4l2_frmivalenum *interval)
{
    const struct list *intervals = &camera->is->intervals;
    if (intervals->listing == NOT_LISTED)
        return ENOTTY;
    if (!offers(camera, interval->pixel_format) ||
        interval->index >= (intervals->listing == DISCRETE ? intervals->count : 1))
        return EINVAL;
    if (intervals->listing == DISCRETE) {
        interval->type = V4L2_FRMIVAL_TYPE_DISCRETE;
        interval->discrete = fraction(intervals->pairs[interval->index]);
        return 0;
    }
    uint32_t one[2] = { 1, 1 };
    interval->type = intervals->listing == STEPS ? V4L2_FRMIVAL_TYPE_STEPWISE : V4L2_FRMIVAL_TYPE_CONTINUOUS;
    interval->stepwise.min = fraction(intervals->pairs[0]);
    interval->stepwise.max = fraction(intervals->pairs[1]);
    interval->stepwise.step = fraction(intervals->listing == STEPS ? intervals->pairs[2] : one);
    return 0;
}

/* The size of a buffer. */
static uint32_t plane_bytes(const struct camera *camera)
{
    return camera->image_bytes + camera->is->data_offset;
}

/* Answers with the format that is set. */
static void state_format(const struct camera *camera, struct v4l2_format *format)
{
    memset(&format->fmt, 0, sizeof format->fmt);
    if (is_multiplanar(camera)) {
        struct v4l2_pix_format_mplane *pixels = &format->fmt.pix_mp;
        pixels->width = camera->width;
        pixels->height = camera->height;
        pixels->pixelformat = camera->format;
        pixels->field = camera->is->field;
        pixels->colorspace = camera->is->colorspace;
        pixels->quantization = (uint8_t)camera->is->quantization;
        pixels->num_planes = (uint8_t)camera->is->planes;
        pixels->plane_fmt[0].bytesperline = camera->stride;
        pixels->plane_fmt[0].sizeimage = plane_bytes(camera);
        return;
    }
    struct v4l2_pix_format *pixels = &format->fmt.pix;
    pixels->width = camera->width;
    pixels->height = camera->height;
    pixels->pixelformat = camera->format;
    pixels->field = camera->is->field;
    pixels->colorspace = camera->is->colorspace;
    pixels->quantization = camera->is->quantization;
    pixels->priv = V4L2_PIX_FMT_PRIV_MAGIC;
    pixels->bytesperline = camera->stride;
    pixels->sizeimage = camera->image_bytes;
}

static int get_format(struct camera *camera, struct v4l2_format *format)
{
    if (!captures(camera, format->type))
        return EINVAL;
    if (!camera->width)
        choose_format(camera, camera->is->formats[0], 640, 480);
    state_format(camera, format);
    return 0;
}

static int set_format(struct camera *camera, struct v4l2_format *format)
{
    if (!captures(camera, format->type))
        return EINVAL;
    /* The first members of both structures are the same. */
    const struct v4l2_pix_format *wanted = &format->fmt.pix;
    const char *name = (const char *)&wanted->pixelformat;
    note(camera, "S_FMT %.4s %ux%u field %u\n", name, wanted->width, wanted->height, wanted->field);
    choose_format(camera, wanted->pixelformat, wanted->width, wanted->height);
    state_format(camera, format);
    return 0;
}

static int rate(struct camera *camera, struct v4l2_streamparm *parameters, int is_set)
{
    if (!captures(camera, parameters->type))
        return EINVAL;
    struct v4l2_captureparm *capture = &parameters->parm.capture;
    uint32_t wanted[2] = { capture->timeperframe.numerator, capture->timeperframe.denominator };
    if (is_set) {
        note(camera, "S_PARM %u/%u\n", wanted[0], wanted[1]);
        choose_interval(camera, wanted);
    } else if (!camera->interval[0]) {
        choose_interval(camera, camera->is->intervals.pairs[0]);
    }
    memset(capture, 0, sizeof *capture);
    capture->capability = V4L2_CAP_TIMEPERFRAME;
    capture->timeperframe = fraction(camera->interval);
    return 0;
}

/* ---- Frames ---- */

static void append(struct queue *queue, uint32_t buffer)
{
    if (queue->count < MOST_BUFFERS)
        queue->buffers[queue->count++] = buffer;
}

static uint32_t take_first(struct queue *queue)
{
    uint32_t first = queue->buffers[0];
    queue->count--;
    memmove(queue->buffers, queue->buffers + 1, queue->count * sizeof *queue->buffers);
    return first;
}

static int64_t period_us(const struct camera *camera)
{
    const uint32_t *pace = camera->is->pace[0] ? camera->is->pace : camera->interval;
    return pace[0] * 1000000LL / pace[1];
}

/* Gives a frame that was captured at `true_us` the time that the camera's clock shows. */
static void stamp(struct camera *camera, struct buffer *buffer, int64_t true_us)
{
    const char *clock = camera->is->clock;
    int64_t number = camera->is->clock_number, since_us = true_us - camera->begun_us;
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    buffer->time_us = true_us;
    if (!strcmp(clock, "monotonic"))
        return;
    if (!strcmp(clock, "frozen")) /* stands still from the start of the stream */
        buffer->time_us = camera->begun_us;
    else if (!strcmp(clock, "constant")) /* always NUMBER microseconds */
        buffer->time_us = number;
    else if (!strcmp(clock, "realtime")) /* the time of day */
        buffer->time_us = true_us + clock_us(CLOCK_REALTIME) - clock_us(CLOCK_MONOTONIC);
    else if (!strcmp(clock, "offset")) /* NUMBER microseconds ahead; behind, if it is negative */
        buffer->time_us = true_us + number;
    else if (!strcmp(clock, "rate")) /* goes at NUMBER per cent of the true rate */
        buffer->time_us = camera->begun_us + since_us * number / 100;
    else if (!strcmp(clock, "steps-back")) /* every tenth frame is NUMBER microseconds early */
        buffer->time_us = true_us - (camera->frame % 10 == 9 ? number : 0);
    else if (!strcmp(clock, "from-start")) /* counts from 0 at the start of the stream */
        buffer->time_us = since_us;
    else if (!strcmp(clock, "pairs")) /* every second frame has the time of the one before it */
        buffer->time_us = camera->frame % 2 ? camera->last_stamp_us : true_us;
    else if (!strcmp(clock, "unknown")) { /* NUMBER microseconds, marked as of an unknown clock */
        buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN;
        buffer->time_us = number;
    } else if (!strcmp(clock, "copied")) { /* NUMBER microseconds, marked as copied from an output buffer */
        buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_COPY;
        buffer->time_us = number;
    } else
        abort();
    camera->last_stamp_us = buffer->time_us;
}

/* Copies the picture of this frame into a buffer. Without a folder of frames, it is grey, with the noise of a sensor. */
static void show(const struct camera *camera, struct buffer *buffer)
{
    unsigned char *picture = buffer->memory + camera->is->data_offset;
    buffer->used = camera->image_bytes;
    if (!camera->is->frame_count) {
        memset(picture, 124 + (int)(camera->frame * 2654435761u >> 16) % 9, camera->image_bytes);
        return;
    }
    char path[sizeof camera->is->frames + 16];
    snprintf(path, sizeof path, "%s/%04u", camera->is->frames, camera->frame % camera->is->frame_count);
    int file = HIDDEN(open)(path, O_RDONLY | O_CLOEXEC);
    ssize_t bytes = read(file, picture, camera->image_bytes);
    if (bytes < 0)
        abort();
    buffer->used = (uint32_t)bytes;
    HIDDEN(close)(file);
}

static void fill(struct camera *camera, uint32_t index, int64_t true_us)
{
    struct buffer *buffer = &camera->buffers[index];
    stamp(camera, buffer, true_us);
    show(camera, buffer);
    buffer->number = camera->is->first_number + camera->frame * camera->is->number_step;
    if (is_hit(camera->is->marked, camera->frame))
        buffer->flags |= V4L2_BUF_FLAG_ERROR;
    if (is_hit(camera->is->empty, camera->frame))
        buffer->used = 0;
    if (is_hit(camera->is->cut, camera->frame))
        buffer->used /= 2;
    append(&camera->filled, index);
}

/* Makes the frames that are due. */
static void advance(struct camera *camera)
{
    int64_t now_us = clock_us(CLOCK_MONOTONIC);
    for (; camera->is_streaming && camera->due_us <= now_us; camera->due_us += period_us(camera)) {
        if (camera->frame >= camera->is->limit) {
            camera->due_us = now_us;
            continue;
        }
        if (camera->queued.count && !is_hit(camera->is->lost, camera->frame))
            fill(camera, take_first(&camera->queued), camera->due_us);
        camera->frame++;
    }
}

static void free_buffers(struct camera *camera)
{
    /* The program unmaps the buffers that it has mapped. */
    camera->buffer_count = camera->queued.count = camera->filled.count = 0;
}

static int request_buffers(struct camera *camera, struct v4l2_requestbuffers *request)
{
    if (!captures(camera, request->type) || request->memory != V4L2_MEMORY_MMAP)
        return EINVAL;
    note(camera, "REQBUFS %u\n", request->count);
    free_buffers(camera);
    struct v4l2_format unused = { .type = request->type };
    get_format(camera, &unused);
    request->count = request->count > MOST_BUFFERS ? MOST_BUFFERS : request->count;
    request->capabilities = V4L2_BUF_CAP_SUPPORTS_MMAP;
    for (uint32_t i = 0; i < request->count; i++) {
        int protection = PROT_READ | PROT_WRITE, flags = MAP_SHARED | MAP_ANONYMOUS;
        unsigned char *memory = HIDDEN(mmap)(NULL, plane_bytes(camera), protection, flags, -1, 0);
        if (memory == MAP_FAILED)
            return ENOMEM;
        memset(memory, 128, plane_bytes(camera));
        camera->buffers[i] = (struct buffer){ .memory = memory };
    }
    camera->buffer_count = request->count;
    return 0;
}

/* The kernel asks for the kind of memory only where a buffer is queued. */
static int check_buffer(const struct camera *camera, const struct v4l2_buffer *buffer)
{
    int has_plane = !is_multiplanar(camera) || (buffer->m.planes && buffer->length >= 1);
    return captures(camera, buffer->type) && has_plane && buffer->index < camera->buffer_count ? 0 : EINVAL;
}

static void state_buffer(const struct camera *camera, struct v4l2_buffer *answer)
{
    const struct buffer *buffer = &camera->buffers[answer->index];
    uint32_t offset = answer->index * BUFFER_OFFSET;
    if (is_multiplanar(camera)) {
        answer->length = 1;
        answer->m.planes[0].bytesused = buffer->used ? buffer->used + camera->is->data_offset : 0;
        answer->m.planes[0].length = plane_bytes(camera);
        answer->m.planes[0].m.mem_offset = offset;
        answer->m.planes[0].data_offset = camera->is->data_offset;
    } else {
        answer->bytesused = buffer->used;
        answer->length = plane_bytes(camera);
        answer->m.offset = offset;
    }
    answer->memory = V4L2_MEMORY_MMAP;
    answer->flags = buffer->flags | V4L2_BUF_FLAG_MAPPED;
    answer->field = camera->is->field;
    answer->sequence = buffer->number;
    answer->timestamp.tv_sec = buffer->time_us / 1000000;
    answer->timestamp.tv_usec = buffer->time_us % 1000000;
}

static int query_buffer(struct camera *camera, struct v4l2_buffer *buffer)
{
    int error = check_buffer(camera, buffer);
    if (!error)
        state_buffer(camera, buffer);
    return error;
}

static int is_in(const struct queue *queue, uint32_t buffer)
{
    for (uint32_t i = 0; i < queue->count; i++)
        if (queue->buffers[i] == buffer)
            return 1;
    return 0;
}

static int queue_buffer(struct camera *camera, struct v4l2_buffer *buffer)
{
    int error = check_buffer(camera, buffer);
    int is_with_driver = is_in(&camera->queued, buffer->index) || is_in(&camera->filled, buffer->index);
    if (error || buffer->memory != V4L2_MEMORY_MMAP || is_with_driver)
        return EINVAL;
    append(&camera->queued, buffer->index);
    return 0;
}

static int take_buffer(struct camera *camera, struct v4l2_buffer *buffer)
{
    buffer->index = 0;
    int error = check_buffer(camera, buffer);
    if (error || !camera->is_streaming)
        return EINVAL;
    /* Waiting here would block all other calls. The programs under test do not rely on it: they poll first. */
    if (!camera->filled.count)
        return EAGAIN;
    buffer->index = take_first(&camera->filled);
    state_buffer(camera, buffer);
    return 0;
}

static int start(struct camera *camera)
{
    note(camera, "STREAMON\n");
    if (!camera->buffer_count)
        return EINVAL;
    if (!camera->interval[0])
        choose_interval(camera, camera->is->intervals.pairs[0]);
    camera->begun_us = clock_us(CLOCK_MONOTONIC);
    camera->due_us = camera->begun_us + period_us(camera);
    camera->last_stamp_us = camera->begun_us;
    camera->frame = 0;
    camera->is_streaming = 1;
    return 0;
}

static int stop(struct camera *camera)
{
    note(camera, "STREAMOFF\n");
    camera->is_streaming = 0;
    camera->queued.count = camera->filled.count = 0;
    return 0;
}

/* ---- Calls ---- */

/* Answers a call. Returns 0 or an error number. */
static int answer(struct camera *camera, uint32_t request, void *argument)
{
#define CALL(name, result)                                                                                             \
    case VIDIOC_##name: {                                                                                              \
        int error = failure(camera, #name);                                                                            \
        return error ? error : (result);                                                                               \
    }
    switch (request) {
        CALL(QUERYCAP, query_capabilities(camera, argument))
        CALL(ENUM_FMT, list_format(camera, argument))
        CALL(ENUM_FRAMESIZES, list_size(camera, argument))
        CALL(ENUM_FRAMEINTERVALS, list_interval(camera, argument))
        CALL(G_FMT, get_format(camera, argument))
        CALL(S_FMT, set_format(camera, argument))
        CALL(G_PARM, rate(camera, argument, 0))
        CALL(S_PARM, rate(camera, argument, 1))
        CALL(REQBUFS, request_buffers(camera, argument))
        CALL(QUERYBUF, query_buffer(camera, argument))
        CALL(QBUF, queue_buffer(camera, argument))
        CALL(DQBUF, take_buffer(camera, argument))
        CALL(STREAMON, start(camera))
        CALL(STREAMOFF, stop(camera))
    default:
        return ENOTTY;
    }
#undef CALL
}

static struct camera *camera_of(int descriptor)
{
    for (size_t i = 0; descriptor > 0 && i < MOST_OPEN; i++)
        if (cameras[i].descriptor == descriptor)
            return &cameras[i];
    return NULL;
}

static int call(struct camera *camera, uint32_t request, void *argument)
{
    pthread_mutex_lock(&lock);
    look(camera);
    /* The buffers that a program gives back are no longer mapped. */
    if (request != VIDIOC_REQBUFS)
        advance(camera);
    int error = is_gone(camera) ? ENODEV : answer(camera, request, argument);
    pthread_mutex_unlock(&lock);
    errno = error ? error : errno;
    return error ? -1 : 0;
}

/* Returns what poll() is to report, and the time at which to look again at the latest. */
static short readiness(struct camera *camera, int64_t *again_us)
{
    pthread_mutex_lock(&lock);
    look(camera);
    advance(camera);
    short found = is_gone(camera) || !camera->is_streaming ? POLLERR : camera->filled.count ? POLLIN | POLLRDNORM : 0;
    *again_us = camera->due_us;
    pthread_mutex_unlock(&lock);
    return found;
}

static int await_frame(struct camera *camera, struct pollfd *wanted, int timeout_ms)
{
    int64_t deadline_us = timeout_ms < 0 ? INT64_MAX : clock_us(CLOCK_MONOTONIC) + timeout_ms * 1000LL, again_us;
    while (!(wanted->revents = readiness(camera, &again_us))) {
        int64_t now_us = clock_us(CLOCK_MONOTONIC), wait_us = LOOK_AGAIN_US;
        if (now_us >= deadline_us)
            return 0;
        wait_us = deadline_us - now_us < wait_us ? deadline_us - now_us : wait_us;
        if (again_us > now_us && again_us - now_us < wait_us)
            wait_us = again_us - now_us;
        usleep((useconds_t)wait_us);
    }
    return 1;
}

/* Turns an open file into a camera. Returns its descriptor, or -1 if opening it is to fail. */
static int open_camera(const char *path, int descriptor)
{
    if (descriptor < 0)
        return -1;
    pthread_mutex_lock(&lock);
    struct camera *camera = cameras;
    while (camera->descriptor)
        if (++camera == cameras + MOST_OPEN)
            abort();
    struct node *node = node_of(path);
    *camera = (struct camera){ .descriptor = descriptor, .node = node, .is = &node->is };
    look(camera);
    note(camera, "open\n");
    int error = failure(camera, "open");
    if (error)
        camera->descriptor = 0;
    pthread_mutex_unlock(&lock);
    if (error) {
        HIDDEN(close)(descriptor);
        errno = error;
        return -1;
    }
    return descriptor;
}

/* ---- The functions that this library replaces ---- */

static int open_any(const char *path, int flags, mode_t mode)
{
    char file[PATH_MAX];
    if (!is_ours(path))
        return HIDDEN(open64)(path, flags, mode);
    int descriptor = HIDDEN(open64)(file_of(path, file), flags, mode);
    return begins(path, "/dev/video") ? open_camera(path, descriptor) : descriptor;
}

static mode_t mode_of(int flags, va_list values)
{
    return flags & (O_CREAT | O_TMPFILE) ? va_arg(values, mode_t) : 0;
}

int open(const char *path, int flags, ...)
{
    va_list values;
    va_start(values, flags);
    mode_t mode = mode_of(flags, values);
    va_end(values);
    return open_any(path, flags, mode);
}

int open64(const char *path, int flags, ...) __attribute__((alias("open")));

int close(int descriptor)
{
    pthread_mutex_lock(&lock);
    struct camera *camera = camera_of(descriptor);
    if (camera) {
        note(camera, "close\n");
        camera->descriptor = 0;
    }
    pthread_mutex_unlock(&lock);
    return HIDDEN(close)(descriptor);
}

DIR *opendir(const char *path)
{
    char file[PATH_MAX];
    return HIDDEN(opendir)(is_ours(path) ? file_of(path, file) : path);
}

char *realpath(const char *path, char *resolved)
{
    if (!is_ours(path))
        return HIDDEN(realpath)(path, resolved);
    char file[PATH_MAX];
    char *end = HIDDEN(realpath)(file_of(path, file), resolved);
    size_t before = strlen(folder());
    if (end && begins(end, folder()))
        memmove(end, end + before, strlen(end + before) + 1);
    return end;
}

int statx(int at, const char *path, int flags, unsigned int mask, struct statx *answer)
{
    char file[PATH_MAX];
    if (!is_ours(path))
        return HIDDEN(statx)(at, path, flags, mask, answer);
    int failed = HIDDEN(statx)(at, file_of(path, file), flags, mask, answer);
    if (!failed && begins(path, "/dev/video")) {
        answer->stx_mode = (answer->stx_mode & ~S_IFMT) | S_IFCHR;
        answer->stx_rdev_major = VIDEO_MAJOR;
        answer->stx_rdev_minor = (uint32_t)atoi(path + strlen("/dev/video"));
    }
    return failed;
}

void *mmap(void *at, size_t bytes, int protection, int flags, int descriptor, off_t offset)
{
    struct camera *camera = camera_of(descriptor);
    if (!camera)
        return HIDDEN(mmap)(at, bytes, protection, flags, descriptor, offset);
    int error = failure(camera, "mmap");
    errno = error ? error : errno;
    return error ? MAP_FAILED : camera->buffers[(size_t)offset / BUFFER_OFFSET].memory;
}

void *mmap64(void *at, size_t bytes, int protection, int flags, int descriptor, off64_t offset)
{
    return mmap(at, bytes, protection, flags, descriptor, (off_t)offset);
}

int poll(struct pollfd *descriptors, nfds_t count, int timeout_ms)
{
    /* The C library's header says that poll() only writes there. */
    const struct pollfd *volatile first = descriptors;
    struct camera *camera = count == 1 ? camera_of(first->fd) : NULL;
    return camera ? await_frame(camera, descriptors, timeout_ms) : HIDDEN(poll)(descriptors, count, timeout_ms);
}

int ioctl(int descriptor, unsigned long request, ...)
{
    va_list values;
    va_start(values, request);
    void *argument = va_arg(values, void *);
    va_end(values);
    struct camera *camera = camera_of(descriptor);
    return camera ? call(camera, (uint32_t)request, argument) : HIDDEN(ioctl)(descriptor, request, argument);
}

/* The v4l crate makes its ioctl calls with this function. */
long syscall(long number, ...)
{
    long arguments[6];
    va_list values;
    va_start(values, number);
    for (int i = 0; i < 6; i++)
        arguments[i] = va_arg(values, long);
    va_end(values);
    struct camera *camera = number == SYS_ioctl ? camera_of((int)arguments[0]) : NULL;
    if (camera)
        return call(camera, (uint32_t)arguments[1], (void *)arguments[2]);
    return HIDDEN(syscall)(number, arguments[0], arguments[1], arguments[2], arguments[3], arguments[4], arguments[5]);
}
