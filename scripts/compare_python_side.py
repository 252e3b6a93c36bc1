"""Runs one side of compare_python.py, and imports nothing else that would count as its memory.

compare_python_side.py SIDE FILM MODEL [SAVED.npz]

Prints times and memory as JSON; with a file, saves what MediaPipe or its stand-in finds instead.
"""

import importlib
import json
import resource
import sys
import time

BYTES = 640 * 480 * 3


def face_mesh(mediapipe, _):
    """Returns FaceMesh as a function from a picture and its number to what it finds."""
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)
    return lambda picture, _: mesh.process(picture).multi_face_landmarks


def face_landmarker(mediapipe, model, has_matrices=False):
    """Returns FaceLandmarker with blendshapes."""
    vision = mediapipe.tasks.vision
    options = vision.FaceLandmarkerOptions(
        base_options=mediapipe.tasks.BaseOptions(model_asset_path=model),
        running_mode=vision.RunningMode.VIDEO,
        output_face_blendshapes=True,
        output_facial_transformation_matrixes=has_matrices,
    )
    landmarker = vision.FaceLandmarker.create_from_options(options)

    def find(picture, number):
        image = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=picture)
        found = landmarker.detect_for_video(image, 33 * number)
        return found.face_landmarks and found

    return find


def tracker(ours, _):
    """Returns facewire's tracker."""
    of_ours = ours.FaceTracker()
    return lambda picture, number: of_ours.process(picture, number / 30, format="rgb")


# The module that each side imports, and what it does with that.
SIDES = {
    "FaceMesh": ("mediapipe", face_mesh),
    "FaceLandmarker": ("mediapipe", face_landmarker),
    "facewire": ("facewire", tracker),
    "facewire as FaceMesh": ("facewire.mediapipe_compat", face_mesh),
    "facewire as FaceLandmarker": ("facewire.mediapipe_compat", face_landmarker),
}


def memory_mb():
    """Returns the largest memory that this process had so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run_side(side, film, model):
    """Plays the pictures twice, the first time to warm up, and prints the figures as JSON."""
    import numpy

    picture, milliseconds, cpu_s, number = numpy.zeros((480, 640, 3), numpy.uint8), [], 0, 0
    with open(film, "rb", buffering=0) as file:
        file.readinto(picture)
        before_mb = memory_mb()
        begun = time.perf_counter()
        module, make = SIDES[side]
        find = make(importlib.import_module(module), model)
        assert find(picture, number)
        first_s = time.perf_counter() - begun
        for is_counted in (False, True):
            file.seek(0)
            while file.readinto(picture) == BYTES:
                number += 1
                begun, cpu_begun_s = time.perf_counter(), time.process_time()
                is_found = find(picture, number)
                if is_counted and is_found:
                    milliseconds.append(1000 * (time.perf_counter() - begun))
                    cpu_s += time.process_time() - cpu_begun_s
    milliseconds.sort()
    print(json.dumps({
        "p50_ms": milliseconds[len(milliseconds) // 2],
        "p95_ms": milliseconds[len(milliseconds) * 95 // 100],
        "cpu_ms": 1000 * cpu_s / len(milliseconds),
        "first_s": first_s,
        "memory_mb": memory_mb(),
        "before_mb": before_mb,
        "frames": len(milliseconds),
    }))


def save(side, film, model, path):
    """Saves what FaceMesh and FaceLandmarker find in every picture: points in pixels, coefficients and matrices."""
    import numpy

    mediapipe, picture, number = importlib.import_module(SIDES[side][0]), numpy.zeros((480, 640, 3), numpy.uint8), 0
    # MediaPipe has had no FaceMesh since 0.10.30.
    mesh = face_mesh(mediapipe, model) if hasattr(mediapipe, "solutions") else None
    landmarker = face_landmarker(mediapipe, model, has_matrices=True)
    saved = {"mesh": [], "landmarker": [], "coefficients": [], "matrices": []}

    def in_pixels(points):
        return [(640 * point.x, 480 * point.y) for point in points]

    with open(film, "rb", buffering=0) as file:
        while file.readinto(picture) == BYTES:
            number += 1
            found = landmarker(picture, number)
            if mesh:
                saved["mesh"].append(in_pixels(mesh(picture, number)[0].landmark))
            saved["landmarker"].append(in_pixels(found.face_landmarks[0]))
            saved["coefficients"].append([shape.score for shape in found.face_blendshapes[0]])
            saved["matrices"].append(found.facial_transformation_matrixes[0])
    numpy.savez(path, names=[shape.category_name for shape in found.face_blendshapes[0]], **saved)


if __name__ == "__main__":
    (save if len(sys.argv) > 4 else run_side)(*sys.argv[1:])
