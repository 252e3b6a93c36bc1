/* The description of a simulated camera: lines of text, each with a key and its values.
 * `Camera` in tests/common/camera.rs writes it. Without a key, the camera behaves like a faultless webcam.
 *
 *   card, driver, bus TEXT                       the names that the camera gives itself
 *   capabilities, device_capabilities NUMBER     V4L2_CAP_...; the second decides whether the camera is multi-planar
 *   formats FOURCC...                            may be empty
 *   sizes LISTING WIDTHxHEIGHT...                discrete; steps or continuous, with smallest, largest and step;
 *                                                none: not listed, and the first one is used
 *   intervals LISTING SECONDS/FRAMES...          the same for the time from frame to frame
 *   granted_format FOURCC                        what the driver sets whatever it is asked for
 *   granted_size WIDTHxHEIGHT
 *   granted_interval SECONDS/FRAMES
 *   pace SECONDS/FRAMES                          the true interval of frames, whatever the driver says
 *   stride, image_bytes, colorspace, quantization, field NUMBER
 *   planes NUMBER                                the planes of a multi-planar camera's formats; it fills the first alone
 *   data_offset NUMBER                           bytes in front of the picture, in that plane
 *   frames FOLDER                                with files 0000, 0001, ..., shown in turn; without it, grey pixels
 *   limit COUNT                                  COUNT frames after the start of the stream, then none
 *   lost, marked, empty, short COUNT OF          the last COUNT of every OF frames are lost on the way, marked as damaged
 *                                                by the driver, without a byte, or cut in half
 *   sequence FIRST STEP                          the numbers of the frames
 *   clock KIND NUMBER                            see `stamp` in camera.c
 *   fail CALL ERRNO NTH                          a call that fails: every time if NTH is 0, else only the NTHth time since
 *                                                the text last changed; the key may be repeated */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <linux/videodev2.h>

#define MOST_ENTRIES 16
#define MOST_TEXT 8192

enum listing { NOT_LISTED, DISCRETE, STEPS, CONTINUOUS };

/* Pairs of numbers: widths and heights, or seconds and frames. */
struct list {
    enum listing listing;
    uint32_t count;
    uint32_t pairs[MOST_ENTRIES][2];
};

/* The last `count` of every `of` frames. */
struct share {
    uint32_t count;
    uint32_t of;
};

struct failure {
    char call[24];
    int error;
    uint32_t nth;
    /* Calls since the text last changed. */
    uint32_t calls;
};

struct description {
    char card[32], driver[16], bus[32];
    uint32_t capabilities, device_capabilities;
    uint32_t formats[MOST_ENTRIES], format_count;
    struct list sizes, intervals;
    /* 0 where the driver grants what it is asked for. */
    uint32_t granted_format, granted_size[2], granted_interval[2], pace[2];
    uint32_t stride, image_bytes, colorspace, quantization, field, planes, data_offset;
    char frames[256];
    uint32_t frame_count;
    uint32_t limit;
    struct share lost, marked, empty, cut;
    uint32_t first_number, number_step;
    char clock[24];
    int64_t clock_number;
    struct failure failures[MOST_ENTRIES];
    uint32_t failure_count;
};

static uint32_t fourcc_of(const char *name)
{
    return v4l2_fourcc(name[0], name[1], name[2], name[3]);
}

static void read_formats(struct description *description, char *values)
{
    description->format_count = 0;
    for (char *name = strtok(values, " "); name && strlen(name) == 4; name = strtok(NULL, " "))
        if (description->format_count < MOST_ENTRIES)
            description->formats[description->format_count++] = fourcc_of(name);
}

static void read_pair(uint32_t pair[2], const char *value)
{
    sscanf(value, "%u%*c%u", &pair[0], &pair[1]);
}

static void read_list(struct list *list, char *values)
{
    static const char *const names[] = { "none", "discrete", "steps", "continuous" };
    char *name = strtok(values, " ");
    for (int listing = NOT_LISTED; name && listing <= CONTINUOUS; listing++)
        if (!strcmp(name, names[listing]))
            list->listing = (enum listing)listing;
    list->count = 0;
    for (char *pair = strtok(NULL, " "); pair; pair = strtok(NULL, " "))
        if (list->count < MOST_ENTRIES)
            read_pair(list->pairs[list->count++], pair);
}

static void read_failure(struct description *description, const char *values)
{
    if (description->failure_count == MOST_ENTRIES)
        return;
    struct failure *failure = &description->failures[description->failure_count++];
    sscanf(values, "%23s %d %u", failure->call, &failure->error, &failure->nth);
}

static void count_frames(struct description *description)
{
    char path[sizeof description->frames + 16];
    do
        snprintf(path, sizeof path, "%s/%04u", description->frames, description->frame_count);
    while (access(path, R_OK) == 0 && ++description->frame_count);
}

static int read_share(struct description *description, const char *key, const char *values)
{
    struct share *share = !strcmp(key, "lost")     ? &description->lost
                          : !strcmp(key, "marked") ? &description->marked
                          : !strcmp(key, "empty")  ? &description->empty
                          : !strcmp(key, "short")  ? &description->cut
                                                   : NULL;
    return share && sscanf(values, "%u %u", &share->count, &share->of) == 2;
}

static int read_number(struct description *description, const char *key, const char *value)
{
    const struct {
        const char *key;
        uint32_t *number;
    } numbers[] = {
        { "capabilities", &description->capabilities },
        { "device_capabilities", &description->device_capabilities },
        { "stride", &description->stride },
        { "image_bytes", &description->image_bytes },
        { "colorspace", &description->colorspace },
        { "quantization", &description->quantization },
        { "field", &description->field },
        { "planes", &description->planes },
        { "data_offset", &description->data_offset },
        { "limit", &description->limit },
    };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (!strcmp(key, numbers[i].key)) {
            *numbers[i].number = (uint32_t)strtoul(value, NULL, 0);
            return 1;
        }
    return 0;
}

static int read_text(struct description *description, const char *key, const char *value)
{
    const struct {
        const char *key;
        char *text;
        size_t room;
    } texts[] = {
        { "card", description->card, sizeof description->card },
        { "driver", description->driver, sizeof description->driver },
        { "bus", description->bus, sizeof description->bus },
        { "frames", description->frames, sizeof description->frames },
    };
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        if (!strcmp(key, texts[i].key)) {
            memset(texts[i].text, 0, texts[i].room);
            snprintf(texts[i].text, texts[i].room, "%s", value);
            return 1;
        }
    return 0;
}

static int read_grant(struct description *description, const char *key, const char *value)
{
    if (!strcmp(key, "granted_format"))
        description->granted_format = fourcc_of(value);
    else if (!strcmp(key, "granted_size"))
        read_pair(description->granted_size, value);
    else if (!strcmp(key, "granted_interval"))
        read_pair(description->granted_interval, value);
    else if (!strcmp(key, "pace"))
        read_pair(description->pace, value);
    else
        return 0;
    return 1;
}

static int read_behaviour(struct description *description, const char *key, char *values)
{
    if (!strcmp(key, "formats"))
        read_formats(description, values);
    else if (!strcmp(key, "sizes"))
        read_list(&description->sizes, values);
    else if (!strcmp(key, "intervals"))
        read_list(&description->intervals, values);
    else if (!strcmp(key, "sequence"))
        sscanf(values, "%u %u", &description->first_number, &description->number_step);
    else if (!strcmp(key, "clock"))
        sscanf(values, "%23s %ld", description->clock, &description->clock_number);
    else if (!strcmp(key, "fail"))
        read_failure(description, values);
    else
        return 0;
    return 1;
}

static void read_line(struct description *description, char *line)
{
    char *values = strchr(line, ' ');
    if (values)
        *values++ = '\0';
    else
        values = line + strlen(line);
    if (!read_text(description, line, values) && !read_number(description, line, values) &&
        !read_share(description, line, values) && !read_grant(description, line, values) &&
        !read_behaviour(description, line, values)) {
        /* With a misspelt key that is ignored, a test would prove nothing. */
        fprintf(stderr, "camera.c: there is no key %s\n", line);
        abort();
    }
}

/* Reads the text, and overwrites parts of it. */
static void read_description(struct description *description, char *text)
{
    *description = (struct description){
        .card = "Simulated camera",
        .driver = "uvcvideo",
        .bus = "usb-0000:01:00.0-1.2",
        .capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING | V4L2_CAP_EXT_PIX_FORMAT | V4L2_CAP_DEVICE_CAPS,
        .device_capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING | V4L2_CAP_EXT_PIX_FORMAT,
        .formats = { V4L2_PIX_FMT_YUYV },
        .format_count = 1,
        .sizes = { DISCRETE, 1, { { 640, 480 } } },
        .intervals = { DISCRETE, 1, { { 1, 30 } } },
        .colorspace = V4L2_COLORSPACE_SRGB,
        .field = V4L2_FIELD_NONE,
        .planes = 1,
        .limit = UINT32_MAX,
        .number_step = 1,
        .clock = "monotonic",
    };
    char *rest = NULL;
    for (char *line = strtok_r(text, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest))
        read_line(description, line);
    if (*description->frames)
        count_frames(description);
}

static int is_hit(struct share share, uint32_t frame)
{
    return share.of && frame % share.of >= share.of - share.count;
}
