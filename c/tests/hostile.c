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

int main(void)
{
    struct facewire_options options = facewire_default_options();
    options.max_faces = 0, refuses_to_open(options, "max_faces");
    options = facewire_default_options(), options.threads = 1000, refuses_to_open(options, "threads");
    options = facewire_default_options(), options.flags = 1u << 31, refuses_to_open(options, "flags");
    options = facewire_default_options(), options.horizontal_fov_deg = NAN, refuses_to_open(options, "fov");
    options = facewire_default_options(), options.profile = "/nonexistent", refuses_to_open(options, "/nonexistent");
    options = facewire_default_options(), options.model = "\xff\xfe", refuses_to_open(options, "UTF-8");
    options = facewire_default_options(), options.networks = "", options.max_faces = 99, refuses_to_open(options, "max_faces");

    struct facewire_tracker *tracker = facewire_open(NULL, NULL, 0);
    assert(tracker != NULL && facewire_message(tracker)[0] == 0);
    size_t bytes = 64 * 48 * 3;
    uint8_t *data = (uint8_t *)calloc(1, bytes);
    struct facewire_face face;
    const struct facewire_picture good = {data, bytes, 64, 48, 0, FACEWIRE_RGB, 0};
    assert(facewire_process(tracker, &good, 0, &face, 1) == 0);
    struct facewire_picture bad[10];
    for (size_t i = 0; i < 10; i++)
        bad[i] = good;
    bad[0].data = NULL, bad[1].bytes = bytes - 1, bad[2].width = 0, bad[3].height = UINT32_MAX, bad[4].stride = 191;
    bad[5].stride = SIZE_MAX, bad[6].format = 10, bad[7].format = UINT32_MAX, bad[8].width = UINT32_MAX, bad[9].bytes = 0;
    for (size_t i = 0; i < 10; i++) {
        assert(facewire_process(tracker, &bad[i], i, &face, 1) == -1);
        assert(strlen(facewire_message(tracker)) > 10);
    }
    assert(facewire_process(tracker, NULL, 0, &face, 1) == -1 && facewire_process(NULL, &good, 0, &face, 1) == -1);
    assert(facewire_process(tracker, &good, UINT64_MAX, NULL, 5) == 0 && facewire_process(tracker, &good, 0, &face, 0) == 0);
    assert(facewire_message(tracker)[0] == 0 && facewire_message(NULL)[0] != 0);
    for (size_t i = 0; i < FACEWIRE_BLENDSHAPES; i++)
        assert(strlen(facewire_blendshape(i)) > 6);
    assert(facewire_blendshape(FACEWIRE_BLENDSHAPES) == NULL && facewire_blendshape(SIZE_MAX) == NULL);
    facewire_reset(tracker), facewire_reset(NULL), facewire_close(NULL), facewire_close(tracker);
    free(data);
    puts("all refused");
    return 0;
}
