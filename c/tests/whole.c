/* Uses each part of the interface on a picture of 640 x 480 pixels in planes of 4:2:2, which a file has. */
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "facewire.h"

enum { WIDTH = 640, HEIGHT = 480, LUMA = WIDTH * HEIGHT, CHROMA = LUMA / 2, PADDING = 13 };

static struct facewire_tracker *open_with(struct facewire_options options)
{
    char message[FACEWIRE_MESSAGE_BYTES] = "";
    struct facewire_tracker *tracker = facewire_open(&options, message, sizeof message);
    if (tracker == NULL)
        fprintf(stderr, "%s\n", message);
    assert(tracker != NULL);
    return tracker;
}

static struct facewire_options default_options(void)
{
    struct facewire_options options;
    facewire_default_options(&options, sizeof options);
    return options;
}

static struct facewire_face face_in(struct facewire_tracker *tracker, const struct facewire_picture *picture, uint64_t time_us)
{
    struct facewire_face face;
    assert(facewire_process(tracker, picture, time_us, &face, 1) == 1);
    return face;
}

/* The face in a picture, by a tracker with these options. */
static struct facewire_face first_face(struct facewire_options options, const struct facewire_picture *picture)
{
    struct facewire_tracker *tracker = open_with(options);
    struct facewire_face face = face_in(tracker, picture, 0);
    facewire_close(tracker);
    return face;
}

static size_t blendshape(const char *name)
{
    size_t index = 0;
    while (strcmp(facewire_blendshape(index), name) != 0)
        index++;
    return index;
}

/* A copy of a plane that has memory of its own, and rows with padding. */
static uint8_t *padded(const uint8_t *plane, size_t width)
{
    uint8_t *copy = (uint8_t *)malloc((width + PADDING) * (HEIGHT - 1) + width);
    for (size_t row = 0; row < HEIGHT; row++)
        memcpy(copy + row * (width + PADDING), plane + row * width, width);
    return copy;
}

static void planes_may_lie_anywhere(const struct facewire_picture *picture)
{
    uint8_t *luma = padded(picture->data, WIDTH);
    uint8_t *cb = padded(picture->data + LUMA, WIDTH / 2), *cr = padded(picture->data + LUMA + CHROMA, WIDTH / 2);
    struct facewire_picture apart = *picture;
    apart.data = luma, apart.bytes = (WIDTH + PADDING) * (HEIGHT - 1) + WIDTH, apart.stride = WIDTH + PADDING;
    apart.chroma[0] = cb, apart.chroma[1] = cr, apart.chroma_stride = WIDTH / 2 + PADDING;
    apart.chroma_bytes = (WIDTH / 2 + PADDING) * (HEIGHT - 1) + WIDTH / 2;
    struct facewire_face wanted = first_face(default_options(), picture), found = first_face(default_options(), &apart);
    assert(memcmp(&wanted, &found, sizeof found) == 0);
    free(luma), free(cb), free(cr);

    uint8_t *together = (uint8_t *)malloc(LUMA + CHROMA), *chroma = (uint8_t *)malloc(CHROMA);
    memcpy(together, picture->data, LUMA);
    for (size_t i = 0; i < CHROMA; i++)
        chroma[i] = together[LUMA + i] = picture->data[LUMA + (i % 2) * CHROMA + i / WIDTH * WIDTH + i % WIDTH / 2];
    struct facewire_picture nv12 = *picture;
    nv12.format = FACEWIRE_NV12, nv12.data = together, nv12.bytes = LUMA + CHROMA;
    wanted = first_face(default_options(), &nv12);
    nv12.bytes = LUMA, nv12.chroma[0] = chroma, nv12.chroma_bytes = CHROMA;
    found = first_face(default_options(), &nv12);
    assert(memcmp(&wanted, &found, sizeof found) == 0);
    free(together), free(chroma);
}

static void options_count(const struct facewire_picture *picture)
{
    struct facewire_options options = default_options();
    const struct facewire_face usual = first_face(options, picture);
    options.method = FACEWIRE_PAPER;
    struct facewire_face face = first_face(options, picture);
    assert(memcmp(usual.landmarks, face.landmarks, sizeof face.landmarks) == 0);
    assert(memcmp(usual.coefficients, face.coefficients, sizeof face.coefficients) != 0);
    options = default_options(), options.settings = "[adjust]\njawOpen = { gain = 0.0, offset = 0.25 }\n";
    face = first_face(options, picture);
    assert(face.coefficients[blendshape("jawOpen")] == 0.25f);
    options = default_options(), options.eye_distance_mm = 31.5f;
    face = first_face(options, picture);
    assert(face.position_mm[2] * 2 > usual.position_mm[2] - 1 && face.position_mm[2] * 2 < usual.position_mm[2] + 1);
    options = default_options(), options.focal_length_px = 2 * 554.256f;
    face = first_face(options, picture);
    assert(face.position_mm[2] > 1.99f * usual.position_mm[2] && face.position_mm[2] < 2.01f * usual.position_mm[2]);
}

/* A neutral face that one tracker is given goes out as a text, and into another tracker. */
static void a_wearer_is_kept(const struct facewire_picture *picture)
{
    struct facewire_tracker *one = open_with(default_options()), *other = open_with(default_options());
    char text[FACEWIRE_PROFILE_BYTES], again[FACEWIRE_PROFILE_BYTES];
    struct facewire_face face = face_in(one, picture, 0);
    assert(face.neutral == 0 && facewire_profile(one, 0, text, sizeof text) == 0);
    assert(facewire_set_neutral(one, &face, 1) == 0);
    assert(face_in(one, picture, 33000).neutral == 2);
    int length = facewire_profile(one, face.id, text, sizeof text);
    assert(length > 5000 && strlen(text) == (size_t)length);
    assert(facewire_profile(one, 0, again, (size_t)length) == -1 && strstr(facewire_message(one), "bytes") != NULL);
    assert(facewire_profile(one, face.id + 1, again, sizeof again) == -1);
    assert(strstr(facewire_message(one), "not in the last picture") != NULL);
    assert(facewire_set_profile(other, 0, text) == 0);
    face = face_in(other, picture, 0);
    assert(face.neutral == 2);
    assert(facewire_profile(other, 0, again, sizeof again) == length && strstr(again, "jawOpen") != NULL);
    assert(facewire_set_profile(other, face.id, text) == 0 && facewire_set_profile(other, face.id + 1, text) == -1);
    facewire_close(one), facewire_close(other);
}

static void a_profile_remains_after_a_reset_until_it_is_taken_away(const struct facewire_picture *picture)
{
    struct facewire_tracker *tracker = open_with(default_options());
    struct facewire_face face = face_in(tracker, picture, 0);
    assert(facewire_set_neutral(tracker, &face, 1) == 0);
    facewire_reset(tracker);
    face = face_in(tracker, picture, 0);
    assert(face.neutral == 2);
    assert(facewire_set_profile(tracker, face.id, NULL) == 0 && face_in(tracker, picture, 33000).neutral == 0);
    facewire_reset(tracker);
    assert(face_in(tracker, picture, 0).neutral == 2);
    assert(facewire_set_profile(tracker, 0, NULL) == 0 && face_in(tracker, picture, 33000).neutral == 0);
    facewire_reset(tracker);
    assert(face_in(tracker, picture, 0).neutral == 0);
    facewire_close(tracker);
}

int main(int argc, char **argv)
{
    struct facewire_picture picture = {0};
    picture.width = WIDTH, picture.height = HEIGHT, picture.format = FACEWIRE_I422, picture.bytes = LUMA + 2 * CHROMA;
    uint8_t *data = (uint8_t *)malloc(picture.bytes);
    picture.data = data;
    FILE *film = argc > 1 ? fopen(argv[1], "rb") : NULL;
    assert(film != NULL && fread(data, 1, picture.bytes, film) == picture.bytes);
    fclose(film);
    planes_may_lie_anywhere(&picture);
    options_count(&picture);
    a_wearer_is_kept(&picture);
    a_profile_remains_after_a_reset_until_it_is_taken_away(&picture);
    free(data);
    puts(facewire_version());
    return 0;
}
