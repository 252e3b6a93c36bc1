/* What a careless program does. Everything is refused, and nothing else happens. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "facewire.h"

static void refuses_to_open(struct facewire_options options, const char *reason)
{
    char message[FACEWIRE_MESSAGE_BYTES], tiny[3];
    assert(facewire_open(&options, message, sizeof message) == NULL);
    assert(strstr(message, reason) != NULL);
    assert(facewire_open(&options, tiny, sizeof tiny) == NULL && strlen(tiny) < sizeof tiny);
    assert(facewire_open(&options, NULL, 7) == NULL && facewire_open(&options, tiny, 0) == NULL);
}

static struct facewire_options default_options(void)
{
    struct facewire_options options;
    facewire_default_options(&options, sizeof options);
    return options;
}

/* Options that a later version will add count for nothing while they are 0. */
static void knows_the_options_of_later_versions(void)
{
    struct {
        struct facewire_options known;
        size_t unknown;
    } later;
    char message[FACEWIRE_MESSAGE_BYTES];
    memset(&later, 0xff, sizeof later);
    facewire_default_options(&later.known, sizeof later);
    assert(later.known.struct_size == sizeof later && later.unknown == 0);
    struct facewire_tracker *tracker = facewire_open(&later.known, message, sizeof message);
    assert(tracker != NULL);
    facewire_close(tracker);
    later.unknown = 1;
    assert(facewire_open(&later.known, message, sizeof message) == NULL && strstr(message, "later version") != NULL);
    uint8_t few[3];
    facewire_default_options((struct facewire_options *)few, sizeof few), facewire_default_options(NULL, 9);
}

/* Programs that were compiled with the first version of the header go on, however many options come after its own. */
static void knows_the_options_of_the_first_version(void)
{
    struct facewire_options options = default_options();
    options.struct_size = sizeof(void *) == 8 ? 72 : 48;
    struct facewire_tracker *tracker = facewire_open(&options, NULL, 0);
    assert(tracker != NULL);
    facewire_close(tracker);
    options.struct_size -= 1, refuses_to_open(options, "facewire_default_options");
}

int main(void)
{
    struct facewire_options options = default_options();
    options.max_faces = 0, refuses_to_open(options, "max_faces");
    options = default_options(), options.threads = 1000, refuses_to_open(options, "threads");
    options = default_options(), options.flags = 1u << 31, refuses_to_open(options, "flags");
    options = default_options(), options.method = 2, refuses_to_open(options, "method");
    options = default_options(), options.method = FACEWIRE_PAPER, options.model = "x", refuses_to_open(options, "method");
    options = default_options(), options.horizontal_fov_deg = NAN, refuses_to_open(options, "fov");
    options.focal_length_px = 500, refuses_to_open(options, "fov");
    options = default_options(), options.focal_length_px = -1, refuses_to_open(options, "focal_length_px");
    options = default_options(), options.eye_distance_mm = 0, refuses_to_open(options, "eye_distance_mm");
    options = default_options(), options.profile = "/nonexistent", refuses_to_open(options, "/nonexistent");
    options = default_options(), options.settings = "smoothing.jaw_ms = 351", refuses_to_open(options, "smoothing.jaw_ms");
    options = default_options(), options.settings = "smoothing.jaw_ms = 100", options.flags = FACEWIRE_STILLS;
    refuses_to_open(options, "[smoothing], but FACEWIRE_STILLS switches");
    options.flags = FACEWIRE_UNSMOOTHED, refuses_to_open(options, "[smoothing], but FACEWIRE_UNSMOOTHED switches");
    options = default_options(), options.model = "\xff\xfe", refuses_to_open(options, "UTF-8");
    options = default_options(), options.networks = "", options.max_faces = 99, refuses_to_open(options, "max_faces");
    options.struct_size = 0, refuses_to_open(options, "facewire_default_options");
    options.struct_size = SIZE_MAX, refuses_to_open(options, "facewire_default_options");
    knows_the_options_of_later_versions();
    knows_the_options_of_the_first_version();

    struct facewire_tracker *tracker = facewire_open(NULL, NULL, 0);
    assert(tracker != NULL && facewire_message(tracker)[0] == 0);
    size_t bytes = 64 * 48 * 3;
    uint8_t *data = (uint8_t *)calloc(1, bytes);
    struct facewire_face face;
    const struct facewire_picture good = {data, bytes, 64, 48, 0, FACEWIRE_RGB, 0, {NULL, NULL}, 0, 0};
    assert(facewire_process(tracker, &good, 0, &face, 1) == 0);
    struct facewire_picture bad[17];
    for (size_t i = 0; i < 17; i++)
        bad[i] = good;
    bad[0].data = NULL, bad[1].bytes = bytes - 1, bad[2].width = 0, bad[3].height = UINT32_MAX, bad[4].stride = 191;
    bad[5].stride = SIZE_MAX, bad[6].format = 10, bad[7].format = UINT32_MAX, bad[8].width = UINT32_MAX, bad[9].bytes = 0;
    for (size_t i = 10; i < 17; i++)
        bad[i].format = FACEWIRE_I420, bad[i].chroma[0] = bad[i].chroma[1] = data, bad[i].chroma_bytes = 32 * 24;
    bad[10].chroma_bytes -= 1, bad[11].chroma[1] = NULL, bad[12].chroma_stride = SIZE_MAX, bad[13].format = FACEWIRE_NV12;
    bad[14].format = FACEWIRE_RGB, bad[15].chroma[0] = NULL, bad[16].width = 4097;
    for (size_t i = 0; i < 17; i++) {
        assert(facewire_process(tracker, &bad[i], i, &face, 1) == -1);
        assert(strlen(facewire_message(tracker)) > 10);
    }
    assert(strstr(facewire_message(tracker), "4097 x 48") != NULL && strstr(facewire_message(tracker), "4096") != NULL);
    assert(facewire_process(tracker, NULL, 0, &face, 1) == -1 && facewire_process(NULL, &good, 0, &face, 1) == -1);
    assert(facewire_process(tracker, &good, UINT64_MAX, NULL, 5) == 0 && facewire_process(tracker, &good, 0, &face, 0) == 0);
    assert(facewire_message(tracker)[0] == 0 && facewire_message(NULL)[0] != 0);
    char text[9] = "";
    assert(facewire_set_neutral(tracker, NULL, 5) == -1 && facewire_set_neutral(tracker, &face, 0) == -1);
    assert(facewire_set_neutral(NULL, &face, 1) == -1 && facewire_profile(NULL, 0, text, sizeof text) == -1);
    assert(facewire_profile(tracker, 0, NULL, 9) == 0 && facewire_profile(tracker, 0, text, 0) == 0);
    assert(facewire_profile(tracker, 7, text, sizeof text) == -1 && facewire_set_profile(tracker, 7, NULL) == -1);
    assert(facewire_set_profile(tracker, 0, NULL) == 0 && facewire_set_profile(tracker, 0, "format = 1") == -1);
    assert(facewire_set_profile(NULL, 0, text) == -1 && strlen(facewire_message(tracker)) > 10);
    for (size_t i = 0; i < FACEWIRE_BLENDSHAPES; i++)
        assert(strlen(facewire_blendshape(i)) > 6);
    assert(facewire_blendshape(FACEWIRE_BLENDSHAPES) == NULL && facewire_blendshape(SIZE_MAX) == NULL);
    facewire_reset(tracker), facewire_reset(NULL), facewire_close(NULL), facewire_close(tracker);
    free(data);
    puts("all refused");
    return 0;
}
