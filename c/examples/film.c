/* Prints the strongest blendshape of each picture of a raw video (4:2:2 planes, full range), and writes all values of its
 * faces:
 *
 *     c/install ~/facewire
 *     export PKG_CONFIG_PATH=~/facewire/lib/pkgconfig
 *     cc c/examples/film.c -o film $(pkg-config --cflags --libs facewire)
 *     ffmpeg -i talk.mp4 -pix_fmt yuvj422p -f rawvideo talk.yuv
 *     LD_LIBRARY_PATH=~/facewire/lib ./film talk.yuv 640 480 [VALUES.f32]
 */
#include <stdio.h>
#include <stdlib.h>

#include "facewire.h"

int main(int argc, char **argv)
{
    if (argc < 4) {
        fprintf(stderr, "usage: film FILE WIDTH HEIGHT [VALUES]\n");
        return 2;
    }
    struct facewire_picture picture = {0};
    picture.width = (uint32_t)atoi(argv[2]);
    picture.height = (uint32_t)atoi(argv[3]);
    picture.format = FACEWIRE_I422;
    picture.bytes = (size_t)picture.width * picture.height * 2;
    uint8_t *data = (uint8_t *)malloc(picture.bytes);
    picture.data = data;

    char message[FACEWIRE_MESSAGE_BYTES];
    struct facewire_tracker *tracker = facewire_open(NULL, message, sizeof message);
    if (tracker == NULL) {
        fprintf(stderr, "%s\n", message);
        return 1;
    }
    FILE *film = fopen(argv[1], "rb"), *values = argc > 4 ? fopen(argv[4], "wb") : NULL;
    int status = 0;
    for (uint64_t frame = 0; film != NULL && fread(data, 1, picture.bytes, film) == picture.bytes; frame++) {
        struct facewire_face face;
        int found = facewire_process(tracker, &picture, frame * 1000000 / 30, &face, 1);
        if (found < 0) {
            fprintf(stderr, "%s\n", facewire_message(tracker));
            status = 1;
            break;
        }
        if (found == 0) {
            printf("%llu: no face\n", (unsigned long long)frame);
            continue;
        }
        size_t strongest = 0;
        for (size_t i = 1; i < FACEWIRE_BLENDSHAPES; i++)
            if (face.coefficients[i] > face.coefficients[strongest])
                strongest = i;
        printf("%llu: %s %.2f, yaw %.0f degrees%s\n", (unsigned long long)frame, facewire_blendshape(strongest),
               (double)face.coefficients[strongest], (double)face.yaw_pitch_roll_deg[0],
               face.score < 15 ? ", a doubtful face" : "");
        if (values != NULL) {
            fwrite(face.coefficients, sizeof face.coefficients, 1, values);
            fwrite(face.rotation_xyzw, sizeof face.rotation_xyzw, 1, values);
            fwrite(face.position_mm, sizeof face.position_mm, 1, values);
            fwrite(&face.visibility, sizeof face.visibility, 1, values);
            fwrite(&face.score, sizeof face.score, 1, values);
            fwrite(face.box_px, sizeof face.box_px, 1, values);
            fwrite(face.landmarks, sizeof face.landmarks, 1, values);
        }
    }
    if (film == NULL)
        status = 1;
    else
        fclose(film);
    if (values != NULL)
        fclose(values);
    facewire_close(tracker);
    free(data);
    return status;
}
