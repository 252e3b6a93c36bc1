/* Forks while another thread uses a tracker. In the child, each call for it is an error, none hangs, and a new tracker works. */
#define _POSIX_C_SOURCE 200809L
#include <assert.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "facewire.h"

static struct facewire_tracker *tracker;
static struct facewire_picture picture;
static atomic_int processed, is_over;

static void *process(void *unused)
{
    for (uint64_t time_us = 0; !atomic_load(&is_over); time_us += 33000) {
        assert(facewire_process(tracker, &picture, time_us, NULL, 0) == 0);
        atomic_fetch_add(&processed, 1);
    }
    return unused;
}

static void be_a_child(int is_last)
{
    static struct facewire_face face;
    static char text[FACEWIRE_PROFILE_BYTES];
    alarm(60);
    assert(facewire_process(tracker, &picture, 0, &face, 1) == -1);
    assert(strstr(facewire_message(tracker), "make a tracker in the child") != NULL);
    assert(facewire_set_neutral(tracker, &face, 1) == -1 && facewire_set_profile(tracker, 0, text) == -1);
    assert(facewire_profile(tracker, 0, text, sizeof text) == -1);
    facewire_reset(tracker);
    facewire_close(tracker);
    if (is_last) {
        struct facewire_tracker *own = facewire_open(NULL, NULL, 0);
        assert(own != NULL && facewire_process(own, &picture, 0, &face, 1) == 0);
        facewire_close(own);
    }
    _exit(0);
}

int main(void)
{
    struct facewire_options options;
    facewire_default_options(&options, sizeof options);
    options.threads = 4;
    tracker = facewire_open(&options, NULL, 0);
    picture.width = 640, picture.height = 480, picture.format = FACEWIRE_GREY, picture.bytes = 640 * 480;
    picture.data = (uint8_t *)calloc(1, picture.bytes);
    pthread_t thread;
    assert(tracker != NULL && pthread_create(&thread, NULL, process, NULL) == 0);
    for (int child = 0; child < 20; child++) {
        int before = atomic_load(&processed), status;
        while (atomic_load(&processed) == before)
            ;
        pid_t id = fork();
        if (id == 0)
            be_a_child(child == 19);
        assert(id > 0 && waitpid(id, &status, 0) == id && status == 0);
    }
    atomic_store(&is_over, 1);
    assert(pthread_join(thread, NULL) == 0);
    facewire_close(tracker);
    free((void *)picture.data);
    puts("no child hung");
    return 0;
}
