"""Prints how much memory this process has after 10,000 and 100,000 frames, and how many frames a second threads process."""

import argparse
import itertools
import os
import pathlib
import resource
import statistics
import threading
import time

import numpy

import facewire
from facewire._film import _decode as decode

FIRST_FRAMES = 10_000
THREADS = (1, 2, 4)
SECONDS = 4


def memory_mb():
    """Returns the resident memory of this process."""
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def measure_memory(pictures, frames):
    """Processes pictures of both kinds, contiguous and not, and loses the face from time to time."""
    tracker, empty, faces = facewire.FaceTracker(), numpy.zeros_like(pictures[0]), 0
    larger = numpy.zeros((500, 700, 3), numpy.uint8)
    for number in range(1, frames + 1):
        picture = pictures[number % len(pictures)]
        if number % 10 == 0:
            larger[10:490, 30:670] = picture
            picture = larger[10:490, 30:670]
        face = tracker.process(empty if number % 500 == 0 else picture, number / 30)
        faces += bool(face and face.blendshapes and face.landmarks.sum())
        if number in (FIRST_FRAMES, frames):
            print(f"{number:>7} frames, {faces} with a face: {memory_mb():.2f} MB")


def frames_per_s(pictures, threads):
    """Returns how many frames so many threads process in a second."""
    counts, end = [0] * threads, []
    begin = threading.Barrier(threads, lambda: end.append(time.monotonic() + SECONDS))

    def run(place):
        tracker = facewire.FaceTracker()
        tracker.process(pictures[0], 0)
        begin.wait()
        for number in itertools.count(1):
            tracker.process(pictures[number % len(pictures)], number / 30)
            if time.monotonic() >= end[0]:
                return
            counts[place] += 1

    running = [threading.Thread(target=run, args=(place,)) for place in range(threads)]
    for thread in running:
        thread.start()
    for thread in running:
        thread.join()
    return sum(counts) / SECONDS


def main():
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--film", required=True, help="a film with a face")
    parser.add_argument("--frames", type=int, default=100_000, help="frames for the memory (default 100000)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of the threads (default 5; 0 leaves them out)")
    args = parser.parse_args()
    pictures = [picture for _, picture in itertools.islice(decode(args.film), 60)]
    measure_memory(pictures, args.frames)
    if not args.rounds:
        return
    rounds = [{threads: frames_per_s(pictures, threads) for threads in THREADS} for _ in range(args.rounds)]
    print(f"{len(os.sched_getaffinity(0))} cores, medians of {args.rounds} rounds, ratios with their lowest and highest")
    for threads in THREADS:
        ratios = [found[threads] / found[1] for found in rounds]
        speed = statistics.median(found[threads] for found in rounds)
        print(f"{threads} threads: {speed:.0f} frames a second, {statistics.median(ratios):.2f} times one thread "
              f"({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
