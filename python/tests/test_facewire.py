"""The promises of the Python package. FACEWIRE_EXACT names a folder in which the example `exact` has written a folder for each film."""

import asyncio
import collections.abc
import concurrent.futures
import contextlib
import copy
import csv
import fractions
import gc
import importlib.metadata
import io
import itertools
import multiprocessing
import os
import pathlib
import pickle
import resource
import struct
import subprocess
import sys
import tempfile
import threading
import time
import types
import unittest
import unittest.mock

import numpy

import facewire
from facewire._film import _decode as decode

DEMO = os.environ["FACEWIRE_FILM"]
EXACT = pathlib.Path(os.environ["FACEWIRE_EXACT"])
# The first pictures of the built-in clip, and what the Rust crate finds in them.
FILM = numpy.fromfile(EXACT / "demo" / "film.i422", numpy.uint8).reshape(-1, 960, 640)[:64]
VALUES = 52 + 4 + 3 + 3 * 478
EXPECTED = numpy.fromfile(EXACT / "demo" / "crate.f32", "<f4").reshape(-1, VALUES)[:64]


def bgr(number):
    """Returns a frame of the clip in the order of OpenCV, converted as FFmpeg does it."""
    luma = FILM[number][:480].astype(int)
    cb, cr = FILM[number][480:].reshape(2, 480, 320).repeat(2, axis=2).astype(int) - 128
    blue, green, red = luma + (14516 * cb >> 13), luma + (-2819 * cb >> 13) + (-5850 * cr >> 13), luma + (11485 * cr >> 13)
    return numpy.stack([blue, green, red], axis=2).clip(0, 255).astype(numpy.uint8)


def time_s(number):
    """Returns the time of a frame at 30 frames a second, in whole microseconds as the service counts it."""
    return number * 1_000_000 // 30 / 1_000_000


PICTURE = bgr(0)


def memory_mb():
    """Returns the resident memory of this process."""
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def without(module):
    """Makes a module impossible to import."""
    return unittest.mock.patch.dict(sys.modules, {module: None})


def write_film(path, times_ms, quarters):
    """Writes the first pictures of the clip as MP4 with these times, to be turned clockwise by quarters of a turn."""
    import av

    with av.open(DEMO) as clip, av.open(path, "w") as film:
        stream = film.add_stream_from_template(clip.streams.video[0])
        for number, packet in enumerate(itertools.islice(clip.demux(video=0), 12)):
            packet.stream, packet.time_base = stream, fractions.Fraction(1, 1000)
            packet.pts = packet.dts = times_ms(number)
            film.mux(packet)
    content = bytearray(pathlib.Path(path).read_bytes())
    # The matrix in the header of the track: to the right becomes (a, b), down becomes (c, d).
    cosine, sine = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]
    matrix = [cosine << 16, sine << 16, 0, -sine << 16, cosine << 16, 0, 0, 0, 1 << 30]
    struct.pack_into(">9i", content, content.index(b"tkhd") + 44, *matrix)
    pathlib.Path(path).write_bytes(content)


class Camera:
    """Stands in for OpenCV, whose camera shows these pictures and is pulled out then."""

    CAP_V4L2, CAP_PROP_POS_MSEC = 200, 0

    def __init__(self, pictures, times_ms=()):
        self.left, self.opened, self.released = iter(pictures), None, threading.Event()
        self.times_ms = iter(times_ms)
        self.has_shown_all = threading.Event()

    def VideoCapture(self, source, kind):
        """Opens the camera."""
        self.opened = source, kind
        return self

    def read(self):
        """Returns the next picture."""
        for picture in self.left:
            return True, picture
        self.has_shown_all.set()
        return False, None

    def get(self, _):
        """Returns the time of the picture, or 0 without one."""
        return next(self.times_ms, 0.0)

    def release(self):
        """Lets go of the camera."""
        self.released.set()

    def plugged(self):
        """Plugs it in."""
        return unittest.mock.patch.dict(sys.modules, {"cv2": self})


def of_film(pictures):
    """Has a video show these pictures, each with its time."""
    return unittest.mock.patch("facewire._film._decode", lambda _: iter(pictures))


def with_room_that_tells(waits):
    """Has `track_async` set this event when a video waits for room."""
    class Room(threading.Semaphore):
        def acquire(self, timeout):
            if super().acquire(blocking=False):
                return True
            waits.set()
            return super().acquire(timeout=timeout)

    parts = types.SimpleNamespace(Event=threading.Event, Semaphore=Room, Thread=threading.Thread)
    return unittest.mock.patch("facewire._film.threading", parts)


def send_back(face, queue):
    """Runs in another process."""
    queue.put(face)


class Results(unittest.TestCase):
    def test_all_values_are_those_of_the_rust_crate_and_of_facewire_track_to_the_last_bit(self):
        for folder in sorted(EXACT.iterdir()):
            width, height, kind = (folder / "size").read_text().split()
            rows = int(height) * {"i420": 3, "i422": 4, "i444": 6}[kind] // 2
            film = numpy.memmap(folder / f"film.{kind}", numpy.uint8, "r").reshape(-1, rows, int(width))
            times_us = numpy.fromfile(folder / "times.u64", "<u8")
            crate, service = (numpy.fromfile(folder / f"{name}.f32", "<f4").reshape(-1, VALUES) for name in ("crate", "service"))
            with open(folder / "track.csv", newline="") as file:
                table = list(csv.DictReader(file))
            self.assertEqual({len(of) for of in (film, times_us, crate, service, table)}, {len(film)})
            tracker, faces = facewire.FaceTracker(), 0
            for number, picture in enumerate(film):
                where = f"{folder.name}, frame {number}"
                face = tracker.process(picture, times_us[number] / 1e6, format=kind)
                found = numpy.full(VALUES, numpy.nan, "<f4")
                if face:
                    found[:] = [*face.coefficients, *face.rotation_xyzw, *face.position_mm, *face.landmarks.ravel()]
                    # The table is rounded, the values of its source are not.
                    rounded = [f"{value:.6f}" for value in found[:52]]
                    row = table[number]
                    self.assertEqual([row["state"], *(row[name] for name in facewire.BLENDSHAPES)], ["live", *rounded], where)
                self.assertEqual(found.tobytes(), crate[number].tobytes(), where)
                self.assertEqual(found.tobytes(), service[number].tobytes(), where)
                faces += bool(face)
            self.assertGreater(faces, 50, folder.name)

    def test_a_face_has_arrays_of_its_own_names_and_angles(self):
        face = facewire.FaceTracker().process(PICTURE)
        self.assertEqual((face.landmarks.shape, face.landmarks.dtype), ((478, 3), numpy.float32))
        self.assertEqual((face.coefficients.shape, face.coefficients.dtype), ((52,), numpy.float32))
        self.assertIs(face.landmarks, face.landmarks)
        self.assertEqual(list(face.blendshapes), list(facewire.BLENDSHAPES))
        self.assertEqual(face["jawOpen"], face.blendshapes["jawOpen"])
        self.assertTrue(all(abs(angle) < 90 for angle in face.yaw_pitch_roll_deg))
        self.assertIn("Face", repr(face))

    def test_the_arrays_of_a_face_cannot_be_written_and_copies_of_them_can(self):
        face = facewire.FaceTracker(stills=True).process(PICTURE)
        for array in (face.coefficients, face.landmarks):
            with self.assertRaisesRegex(ValueError, "read-only"):
                array[:] = 0
            array.copy()[:] = 0
        self.assertGreater(face.landmarks.max(), 0)

    def test_a_face_is_a_mapping_from_names_to_coefficients(self):
        face = facewire.FaceTracker(stills=True).process(PICTURE)
        self.assertIsInstance(face, collections.abc.Mapping)
        self.assertEqual((list(face), len(face)), (list(facewire.BLENDSHAPES), 52))
        self.assertEqual(list(face.keys()), list(facewire.BLENDSHAPES))
        self.assertEqual(list(face.values()), face.coefficients.tolist())
        self.assertEqual(list(face.items()), list(face.blendshapes.items()))
        self.assertEqual(dict(face), face.blendshapes)
        self.assertEqual({**face}, face.blendshapes)
        self.assertTrue("jawOpen" in face and "smile" not in face and 3 not in face)
        self.assertEqual(face.get("jawOpen"), face["jawOpen"])
        self.assertEqual((face.get("smile"), face.get("smile", 0.5), face.get(0)), (None, 0.5, None))
        self.assertRaises(KeyError, lambda: face[0])
        self.assertEqual(face, unittest.mock.ANY)

    def test_an_unknown_name_of_a_coefficient_is_a_key_error_with_the_nearest_name(self):
        face = facewire.FaceTracker(stills=True).process(PICTURE)
        for given, meant in [("jawopen", "jawOpen"), ("eye_blink_left", "eyeBlinkLeft"), ("mouthSmielRight", "mouthSmileRight")]:
            with self.assertRaisesRegex(KeyError, rf"{given} is not a blendshape; did you mean {meant}\?"):
                face[given]
        with self.assertRaisesRegex(KeyError, "xyz is not a blendshape; facewire.BLENDSHAPES has all names"):
            face["xyz"]

    def test_a_face_can_be_copied_pickled_and_sent_to_another_process_and_stays_equal(self):
        tracker = facewire.FaceTracker(stills=True)
        face, other = tracker.process(PICTURE), tracker.process(bgr(1))
        copies = [copy.copy(face), copy.deepcopy(face)]
        copies += [pickle.loads(pickle.dumps(face, protocol)) for protocol in range(pickle.HIGHEST_PROTOCOL + 1)]
        queue = multiprocessing.get_context("spawn").Queue()
        process = multiprocessing.get_context("spawn").Process(target=send_back, args=(face, queue))
        process.start()
        copies.append(queue.get(timeout=120))
        process.join()
        for same in copies:
            self.assertEqual((same, hash(same), repr(same)), (face, hash(face), repr(face)))
            for name in ("id", "blendshapes", "yaw_pitch_roll_deg", "rotation_xyzw", "position_mm", "gaze_yaw_pitch_deg", "neutral", "visibility", "score"):
                self.assertEqual(getattr(same, name), getattr(face, name), name)
            self.assertEqual(same.landmarks.tobytes(), face.landmarks.tobytes())
            self.assertFalse(same.landmarks.flags.writeable)
        self.assertNotEqual(face, other)
        self.assertNotEqual(face, face.blendshapes)
        facewire.FaceTracker().set_neutral(copies)
        restore, values = face.__reduce__()
        for place, wrong in [(1, face.landmarks[:3]), (2, face.coefficients[:3]), (6, "maybe")]:
            with self.assertRaises(ValueError):
                restore(*values[:place], wrong, *values[place + 1:])

    def test_any_strides_and_orders_of_one_picture_give_one_face(self):
        import PIL.Image

        wide = numpy.zeros((500, 700, 3), numpy.uint8)
        wide[10:490, 20:660] = PICTURE
        frozen = PICTURE.copy()
        frozen.flags.writeable = False
        rgb = numpy.ascontiguousarray(PICTURE[:, :, ::-1])
        rgba = numpy.dstack([rgb, rgb[:, :, :1]])
        given = {
            "contiguous": (PICTURE, None),
            "read-only": (frozen, None),
            "part of a larger one": (wide[10:490, 20:660], None),
            "column-major": (numpy.asfortranarray(PICTURE), None),
            "upside down twice": (numpy.ascontiguousarray(PICTURE[::-1])[::-1], None),
            "channels first": (numpy.ascontiguousarray(PICTURE.transpose(2, 0, 1)).transpose(1, 2, 0), None),
            "turned channels": (rgb[:, :, ::-1], None),
            "rgb": (rgb, "rgb"),
            "rgba": (rgba, "rgb"),
            "bgra": (numpy.dstack([PICTURE, PICTURE[:, :, :1]]), None),
            "every second of twice as many": (PICTURE.repeat(2, axis=1)[:, ::2], None),
            "subclass": (PICTURE.view(numpy.recarray), None),
            "Pillow": (PIL.Image.fromarray(rgb), None),
            "Pillow with alpha": (PIL.Image.fromarray(rgba), None),
        }
        wanted = facewire.FaceTracker(stills=True).process(PICTURE)
        for name, (array, kind) in given.items():
            face = facewire.FaceTracker(stills=True).process(array, format=kind)
            self.assertEqual(face.landmarks.tobytes(), wanted.landmarks.tobytes(), name)
        palette = PIL.Image.fromarray(rgb).convert("P")
        self.assertIsNotNone(facewire.FaceTracker().process(palette))
        self.assertIsNotNone(facewire.FaceTracker().process(PICTURE[:, :, 1]), "grey")

    def test_a_grey_picture_of_pillow_is_read_as_grey(self):
        import PIL.Image

        luma = numpy.ascontiguousarray(FILM[0][:480])
        wanted = facewire.FaceTracker(stills=True).process(luma)
        for kind in (None, "grey", "rgb"):
            found = facewire.FaceTracker(stills=True).process(PIL.Image.fromarray(luma), format=kind)
            self.assertEqual(found.landmarks.tobytes(), wanted.landmarks.tobytes(), kind)

    def test_a_picture_of_pillow_is_turned_as_its_exif_orientation_says(self):
        import PIL.Image

        upright = PIL.Image.fromarray(numpy.ascontiguousarray(PICTURE[:, :, ::-1]))
        wanted = facewire.FaceTracker(stills=True).process(upright)
        # What the camera stored, for each orientation, of a picture that is upright when it is shown.
        turned = {3: PIL.Image.ROTATE_180, 6: PIL.Image.ROTATE_90, 8: PIL.Image.ROTATE_270, 2: PIL.Image.FLIP_LEFT_RIGHT}
        for orientation, turn in turned.items():
            stored = io.BytesIO()
            exif = PIL.Image.Exif()
            exif[0x0112] = orientation
            upright.transpose(turn).save(stored, "png", exif=exif)
            found = facewire.FaceTracker(stills=True).process(PIL.Image.open(stored))
            self.assertEqual(found.landmarks.tobytes(), wanted.landmarks.tobytes(), orientation)
        with unittest.mock.patch.object(PIL.Image.Image, "getexif", side_effect=SyntaxError("not a TIFF file")):
            found = facewire.FaceTracker(stills=True).process(upright)
        self.assertEqual(found.landmarks.tobytes(), wanted.landmarks.tobytes(), "damaged EXIF data")

    def test_names_of_formats_may_be_in_upper_case(self):
        rgb = numpy.ascontiguousarray(PICTURE[:, :, ::-1])
        found = facewire.FaceTracker(stills=True).process(rgb, format="RGB")
        self.assertEqual(found, facewire.FaceTracker(stills=True).process(rgb, format="rgb"))

    def test_several_faces_and_a_picture_without_any(self):
        tracker = facewire.FaceTracker(max_faces=3, stills=True)
        pair = numpy.hstack([PICTURE, bgr(len(FILM) - 1)])
        faces = tracker.process_all(pair)
        self.assertEqual(len({face.id for face in faces}), 2)
        self.assertEqual(tracker.process_all(numpy.zeros_like(pair)), [])
        self.assertIsNone(tracker.process(numpy.zeros_like(pair)))

    def test_the_box_surrounds_the_landmarks_and_the_score_tells_a_face_in_view_from_a_covered_one(self):
        tracker = facewire.FaceTracker(stills=True)
        face = tracker.process(PICTURE)
        self.assertTrue(17 < face.score < 30)
        left, top, right, bottom = face.box_px
        self.assertEqual((left, top), tuple(face.landmarks[:, :2].min(axis=0)))
        self.assertEqual((right, bottom), tuple(face.landmarks[:, :2].max(axis=0)))
        covered = PICTURE.copy()
        covered[int(top):int(top + 0.55 * (bottom - top))] = 30
        doubtful = tracker.process(covered)
        self.assertTrue(doubtful is None or 0 <= doubtful.score < face.score - 5)

    def test_faces_at_rest_become_the_neutral_face(self):
        tracker = facewire.FaceTracker()
        faces = [tracker.process(PICTURE, 0.03 * number) for number in range(10)]
        self.assertEqual(faces[0].neutral, "mean")
        tracker.set_neutral(faces)
        self.assertEqual(tracker.process(PICTURE, 1.0).neutral, "calibrated")

    def test_a_profile_remains_after_a_reset_until_it_is_taken_away(self):
        with facewire.FaceTracker() as tracker:
            tracker.set_neutral([tracker.process(PICTURE, 0.0)])
        face = tracker.process(PICTURE, 0.0)
        self.assertEqual(face.neutral, "calibrated")
        tracker.set_profile(None, face.id)
        self.assertEqual(tracker.process(PICTURE, 0.03).neutral, "mean")
        tracker.reset()
        self.assertEqual(tracker.process(PICTURE, 0.0).neutral, "calibrated")
        tracker.set_profile(None)
        self.assertEqual(tracker.process(PICTURE, 0.03).neutral, "mean")
        tracker.reset()
        self.assertEqual(tracker.process(PICTURE, 0.0).neutral, "mean")

    def test_what_is_known_of_a_wearer_goes_out_as_a_text_and_comes_back_from_it_or_from_its_file(self):
        tracker = facewire.FaceTracker()
        face = tracker.process(PICTURE, 0.0)
        self.assertIsNone(tracker.profile())
        for number in range(1, 100):
            face = tracker.process(PICTURE, 0.1 * number)
        self.assertEqual(face.neutral, "estimated")
        text = tracker.profile()
        self.assertRegex(text, r"(?s)format = 1\n.*jawOpen = ")
        with self.assertRaisesRegex(ValueError, "not in the last picture"):
            tracker.profile(face.id + 1)
        later = facewire.FaceTracker()
        later.set_profile(text)
        self.assertEqual(later.process(PICTURE, 0.0).neutral, "calibrated")
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder) / "anna.toml"
            file.write_text(text)
            face = facewire.FaceTracker(profile=file).process(PICTURE, 0.0)
        self.assertEqual(face.neutral, "calibrated")
        later.set_profile(text, face.id)
        with self.assertRaisesRegex(ValueError, "not in the last picture"):
            later.set_profile(text, face.id + 1)
        with self.assertRaises(facewire.FacewireError):
            later.set_profile("format = 1")

    def test_settings_and_method_count(self):
        def coefficients(**options):
            return facewire.FaceTracker(**options).process(PICTURE, 0.0).coefficients

        usual, paper = coefficients(), coefficients(method="paper")
        self.assertFalse(numpy.array_equal(usual, paper))
        self.assertLess(abs(usual - paper).max(), 0.5)
        settings = "[adjust]\njawOpen = { gain = 0.0, offset = 0.25 }\n[smoothing]\njaw = \"off\"\n"
        self.assertEqual(facewire.FaceTracker(settings=settings).process(PICTURE, 0.0)["jawOpen"], 0.25)
        off = "\n".join(f'smoothing.{part} = "off"' for part in ("lids", "gaze", "brows", "mouth", "jaw", "cheeks", "head"))
        unsmoothed = facewire.FaceTracker(smoothing=False)
        by_settings = facewire.FaceTracker(settings=off)
        for number in range(5):
            faces = [tracker.process(bgr(number), time_s(number)) for tracker in (unsmoothed, by_settings)]
            self.assertEqual(*faces)

    def test_the_position_follows_from_the_focal_length_and_the_distance_between_the_pupils(self):
        def depth_mm(**options):
            return facewire.FaceTracker(**options).process(PICTURE, 0.0).position_mm[2]

        usual = depth_mm()
        self.assertAlmostEqual(depth_mm(focal_length_px=320 / numpy.tan(numpy.pi / 6)), usual, 1)
        self.assertAlmostEqual(depth_mm(focal_length_px=640 / numpy.tan(numpy.pi / 6)), 2 * usual, 1)
        self.assertAlmostEqual(depth_mm(eye_distance_mm=126), 2 * usual, 1)

    def test_the_apparent_rotation_has_the_yaw_that_the_landmarks_show(self):
        face = facewire.FaceTracker().process(PICTURE, 0.0)
        x, y, z, w = face.apparent_rotation_xyzw
        cosine_of_pitch = numpy.cos(numpy.radians(face.yaw_pitch_roll_deg[1]))
        # By Rz(roll) Rx(-pitch) Ry(yaw), the lowest row of the matrix has the yaw alone, but for the cosine of the pitch.
        sine_of_yaw = -2 * (x * z - w * y) / cosine_of_pitch
        self.assertAlmostEqual(numpy.degrees(numpy.arcsin(sine_of_yaw)), face.yaw_pitch_roll_deg[0] / 0.9, 3)

    def test_of_several_faces_each_has_its_own_neutral_face(self):
        tracker = facewire.FaceTracker(max_faces=2)
        pair = numpy.hstack([PICTURE, bgr(20)])
        first, second = tracker.process_all(pair, 0.0)
        with self.assertRaisesRegex(ValueError, "different ids"):
            tracker.set_neutral([first, second])
        tracker.set_neutral([second])
        self.assertEqual([face.neutral for face in tracker.process_all(pair, 0.03)], ["mean", "calibrated"])
        tracker.reset()
        with self.assertRaisesRegex(ValueError, "not in the last picture"):
            tracker.set_neutral([second])

    def test_a_film_is_tracked_by_whatever_decoder_there_is(self):
        coefficients = []
        for hidden in ("av", "cv2"):
            with without(hidden):
                seen = list(itertools.islice(facewire.track(DEMO, smoothing=False), 20))
            self.assertEqual([frame.number for frame in seen], list(range(20)))
            self.assertAlmostEqual(seen[15].time_s, 0.5, places=2)
            for frame, expected in zip(seen, EXPECTED):
                worst = numpy.abs(frame.face.landmarks - expected[59:].reshape(478, 3))[:, :2].max()
                self.assertLess(worst, 1.5, "pixels, by another decoder")
            coefficients.append([frame.face.coefficients for frame in seen])
        self.assertLess(numpy.abs(numpy.subtract(*coefficients)).max(), 0.002, "between PyAV and OpenCV")
        with without("av"), without("cv2"), self.assertRaises(facewire.FacewireError):
            list(facewire.track(DEMO))

    def test_a_video_of_two_people_is_tracked_with_both_and_one_of_one_person_as_before(self):
        pair = [numpy.hstack([bgr(number), bgr(number + 20)]) for number in range(4)]
        pictures = [(number / 30, picture) for number, picture in enumerate([*pair, numpy.zeros_like(PICTURE)])]
        with of_film(pictures):
            both = list(facewire.track(DEMO, max_faces=2))
            first = list(facewire.track(DEMO))
        self.assertEqual([len(frame.faces) for frame in both], [2, 2, 2, 2, 0])
        self.assertEqual([len(frame.faces) for frame in first], [1, 1, 1, 1, 0])
        for frame in both[:4]:
            number, time, face = frame
            self.assertEqual((number, time, face), (frame.number, frame.time_s, frame.face))
            self.assertIs(face, frame.faces[0])
            self.assertEqual([face.id for face in frame.faces], [face.id for face in both[0].faces])
            self.assertLess(frame.faces[0].id, frame.faces[1].id)
        self.assertEqual((first[-1].face, first[-1].faces), (None, ()))
        for frame in both:
            again = pickle.loads(pickle.dumps(frame))
            self.assertEqual((again, again.faces), (frame, frame.faces))

    def test_a_frame_with_another_number_keeps_its_faces_and_its_picture(self):
        with of_film([(0.0, numpy.hstack([bgr(0), bgr(20)]))]):
            (frame,) = facewire.track(DEMO, max_faces=2, pictures=True)
        other = frame._replace(number=5)
        self.assertEqual((other.number, other.time_s, other.face), (5, frame.time_s, frame.face))
        self.assertEqual((len(other.faces), other.faces), (2, frame.faces))
        self.assertIs(other.picture, frame.picture)

    def test_both_decoders_give_the_same_pictures_at_the_same_times_the_right_way_up(self):
        def times_ms(number):
            return 500 + 40 * number + 9 * (number % 3)

        with tempfile.TemporaryDirectory() as folder:
            for quarters in range(4):
                film = os.path.join(folder, f"{quarters}.mp4")
                write_film(film, times_ms, quarters)
                both = []
                for hidden in ("av", "cv2"):
                    with without(hidden):
                        both.append(list(itertools.islice(decode(film), 10)))
                upright = numpy.rot90(bgr(0), -quarters)
                for number, ((time_s, picture), (other_s, other)) in enumerate(zip(*both)):
                    self.assertAlmostEqual(time_s - both[0][0][0], (times_ms(number) - times_ms(0)) / 1000, places=3)
                    self.assertAlmostEqual(time_s - both[0][0][0], other_s - both[1][0][0], places=3)
                    self.assertEqual(picture.shape, other.shape)
                    self.assertLessEqual(numpy.abs(picture.astype(int) - other).max(), 1, "steps of 255")
                self.assertLess(numpy.abs(both[0][0][1].astype(int) - upright).mean(), 3, "turned as the film says")
                self.assertEqual([len(pictures) for pictures in both], [10, 10])


class Times(unittest.TestCase):
    def test_times_that_go_back_are_refused_until_a_reset(self):
        tracker = facewire.FaceTracker()
        for time_s in (1.0, 1.5, 1.5):
            tracker.process(PICTURE, time_s)
        with self.assertRaisesRegex(ValueError, r"time_s went back from 1.5 to 0.5: .*reset\(\) before another video"):
            tracker.process(PICTURE, time_s=0.5)
        self.assertIsNotNone(tracker.process(PICTURE, time_s=1.6))
        tracker.reset()
        self.assertIsNotNone(tracker.process(PICTURE, time_s=0.5))

    def test_times_in_milliseconds_are_refused(self):
        for step_ms in (1000 / 30, 1000 / 120):
            tracker = facewire.FaceTracker()
            with self.assertRaisesRegex(ValueError, "seems to be in milliseconds; divide it by 1000"):
                for number in range(6):
                    tracker.process(PICTURE, number * step_ms)
            tracker.reset()
            self.assertIsNotNone(tracker.process(PICTURE, 0.0))

    def test_long_gaps_after_a_beginning_without_are_no_fault(self):
        tracker = facewire.FaceTracker()
        for time_s in (0.0, 0.04, *range(100, 1000, 100)):
            self.assertIsNotNone(tracker.process(PICTURE, time_s))

    def test_a_short_step_after_times_that_were_refused_shows_that_they_were_right(self):
        tracker = facewire.FaceTracker()
        with self.assertRaisesRegex(ValueError, "seems to be in milliseconds"):
            for number in range(6):
                tracker.process(PICTURE, 6.0 * number)
        for time_s in (30.1, 40.0, 50.0):
            self.assertIsNotNone(tracker.process(PICTURE, time_s))

    def test_a_picture_that_is_refused_leaves_no_time(self):
        tracker = facewire.FaceTracker()
        with self.assertRaises(ValueError):
            tracker.process(PICTURE[None], 5.0)
        self.assertIsNotNone(tracker.process(PICTURE, 0.0))

    def test_times_are_given_for_all_pictures_or_for_none(self):
        tracker = facewire.FaceTracker()
        tracker.process(PICTURE)
        with self.assertRaisesRegex(ValueError, "give time_s for every picture or for none"):
            tracker.process(PICTURE, 100.0)
        self.assertIsNotNone(tracker.process(PICTURE))

    def test_a_video_may_be_tracked_again_and_its_times_may_begin_anew(self):
        pictures = [(time_s, PICTURE) for time_s in (2.0, 2.5, 3.0, 1.0, 1.25, 1.5)]
        tracker = facewire.FaceTracker()
        tracker.process(PICTURE)
        with of_film(pictures):
            first, second = (list(facewire.track(DEMO, tracker)) for _ in range(2))
        for frames in (first, second):
            self.assertEqual([frame.time_s for frame in frames], [0.0, 0.5, 1.0, 1.0, 1.25, 1.5])
        for one, other in zip(first, second):
            self.assertEqual(one.face.coefficients.tobytes(), other.face.coefficients.tobytes())

    def test_short_steps_back_in_a_video_move_no_later_time(self):
        pictures = [(time_s, PICTURE) for time_s in (0.0, 0.04, 0.039, 0.08, 0.079, 0.12)]
        with of_film(pictures):
            frames = list(facewire.track(DEMO))
        self.assertEqual([frame.time_s for frame in frames], [0.0, 0.04, 0.04, 0.08, 0.08, 0.12])

    def test_the_pictures_of_a_video_may_be_any_time_apart(self):
        pictures = [(10.0 * number, PICTURE) for number in range(8)]
        with of_film(pictures):
            frames = list(facewire.track(DEMO))
        self.assertEqual([frame.time_s for frame in frames], [time_s for time_s, _ in pictures])

    def test_a_tracker_is_given_the_true_times_of_a_video_with_gaps(self):
        pictures = [(time_s, PICTURE) for time_s in (3.0, 3.04, 9.0, 500.0)]
        tracker = unittest.mock.Mock(**{"process_all.return_value": []})
        with of_film(pictures):
            list(facewire.track(DEMO, tracker))
        given_s = [call.args[1] for call in tracker.process_all.call_args_list]
        numpy.testing.assert_allclose(given_s, [0.0, 0.04, 6.0, 497.0])

    def test_at_the_end_of_a_with_a_tracker_is_reset(self):
        with facewire.FaceTracker() as tracker:
            tracker.process(PICTURE, 1.0)
        self.assertIsNotNone(tracker.process(PICTURE, 0.5))

    def test_the_times_of_stills_are_not_read(self):
        tracker = facewire.FaceTracker(stills=True)
        for time_s in (3.0, 1.0, None, 1e6, 2e6, 3e6, 4e6, 5e6, 6e6):
            self.assertIsNotNone(tracker.process(PICTURE, time_s))


class Cameras(unittest.TestCase):
    pictures = [bgr(number) for number in range(10)]

    def test_a_camera_is_tracked_by_number_or_path_with_its_pictures_until_it_is_pulled_out(self):
        for source, opened in [(0, 0), ("/dev/null", "/dev/null")]:
            camera, seen = Camera(self.pictures[:3]), []
            clock = types.SimpleNamespace(monotonic=iter((5.0, 5.04, 7.5)).__next__)
            with camera.plugged(), unittest.mock.patch("facewire._film.time", clock):
                with self.assertRaisesRegex(facewire.FacewireError, f"camera {source} gives no pictures"):
                    for frame in facewire.track(source, pictures=True):
                        seen.append(frame)
            self.assertEqual(camera.opened, (opened, Camera.CAP_V4L2))
            self.assertTrue(camera.released.is_set())
            numpy.testing.assert_allclose([frame.time_s for frame in seen], [0.0, 0.04, 2.5])
            self.assertEqual([bool(frame.face) for frame in seen], [True] * 3)
            for frame, picture in zip(seen, self.pictures):
                self.assertIs(frame.picture, picture)

    def test_pictures_of_a_camera_have_the_times_of_its_driver_while_these_rise_and_then_those_of_the_clock(self):
        camera, seen = Camera(self.pictures[:6], [9000.0, 9040.0, 9080.0, 9080.0, 9200.0]), []
        # The second and third picture waited, and come together with the first one.
        clock = types.SimpleNamespace(monotonic=iter((5.0, 5.001, 5.002, 5.052, 5.082, 5.112)).__next__)
        with camera.plugged(), unittest.mock.patch("facewire._film.time", clock):
            with self.assertRaisesRegex(facewire.FacewireError, "gives no pictures"):
                for frame in facewire.track(0):
                    seen.append(frame.time_s)
        numpy.testing.assert_allclose(seen, [0.0, 0.04, 0.08, 0.13, 0.16, 0.19])

    def test_frames_keep_no_picture_that_nobody_asked_for(self):
        with of_film([(0.0, PICTURE)]):
            (frame,) = facewire.track(DEMO)
        self.assertIsNone(frame.picture)

    def test_a_camera_is_released_at_a_break_and_at_the_end_of_a_with(self):
        camera = Camera(self.pictures)
        with camera.plugged():
            for _ in facewire.track(0):
                break
            self.assertTrue(camera.released.is_set())
            camera.released.clear()
            with facewire.track(0) as frames:
                next(frames)
                self.assertFalse(camera.released.is_set())
            self.assertTrue(camera.released.is_set())
            self.assertEqual(list(frames), [])

    def test_a_camera_without_opencv_is_an_error_that_says_what_to_install(self):
        with without("cv2"), self.assertRaisesRegex(facewire.FacewireError, "install OpenCV .pip install opencv-python"):
            next(facewire.track(0))

    def consume(self, camera, taken, **options):
        """Takes a frame, then waits until the camera has shown all, then takes what is left."""
        async def take():
            async for frame in facewire.track_async(0, **options):
                taken.append(frame.number)
                await asyncio.to_thread(camera.has_shown_all.wait)

        with camera.plugged():
            asyncio.run(take())

    def test_a_slow_consumer_who_wants_all_frames_gets_ten_of_ten_in_order(self):
        camera, taken = Camera(self.pictures), []
        with self.assertRaisesRegex(facewire.FacewireError, "gives no pictures"):
            self.consume(camera, taken)
        self.assertEqual(taken, list(range(10)))
        self.assertTrue(camera.released.is_set())

    def test_a_slow_consumer_who_wants_the_newest_frame_gets_it_and_not_those_before(self):
        camera, taken = Camera(self.pictures), []
        with self.assertRaisesRegex(facewire.FacewireError, "gives no pictures"):
            self.consume(camera, taken, newest=True)
        self.assertEqual(taken[-1], 9)
        self.assertEqual(len(taken), 1 if taken[0] == 9 else 2)

    def test_a_video_waits_for_a_slow_consumer(self):
        decoded, waits_or_has_ended = [], threading.Event()

        def decode_some():
            for number in range(24):
                decoded.append(number)
                yield number / 30, PICTURE
            waits_or_has_ended.set()

        async def take():
            taken = []
            async for frame in facewire.track_async(DEMO):
                taken.append(frame.number)
                await asyncio.to_thread(waits_or_has_ended.wait)
                self.assertLessEqual(len(decoded), len(taken) + 10)
            return taken

        with of_film(decode_some()), with_room_that_tells(waits_or_has_ended):
            self.assertEqual(asyncio.run(take()), list(range(24)))

    def test_any_exception_of_the_thread_is_raised_where_frames_are_awaited(self):
        class Panic(BaseException):
            pass

        def fail():
            yield 0.0, PICTURE
            raise Panic

        async def take():
            with self.assertRaises(Panic):
                async for _ in facewire.track_async(DEMO):
                    pass

        with of_film(fail()):
            asyncio.run(take())

    def test_a_loop_that_is_closed_without_its_generators_frees_the_camera_and_the_video(self):
        camera, closed, waits = Camera(itertools.repeat(PICTURE)), threading.Event(), threading.Event()

        def decode():
            try:
                yield from ((number / 30, PICTURE) for number in itertools.count())
            finally:
                closed.set()

        patch = unittest.mock.patch("threading.excepthook")
        with camera.plugged(), of_film(decode()), with_room_that_tells(waits), patch as uncaught:
            for source, is_free in [(0, camera.released), (DEMO, closed)]:
                before, loop = threading.enumerate(), asyncio.new_event_loop()
                frames = facewire.track_async(source)
                self.assertEqual(loop.run_until_complete(frames.__anext__()).number, 0)
                # A camera never waits.
                self.assertTrue(source == 0 or waits.wait(60))
                loop.close()
                self.assertTrue(is_free.wait(60), source)
                [thread.join() for thread in threading.enumerate() if thread not in before]
        uncaught.assert_not_called()

    def test_networks_are_loaded_while_the_event_loop_goes_on(self):
        loaded = []

        def track(*arguments, **options):
            loaded.append(threading.current_thread())
            return facewire.track(*arguments, **options)

        async def take():
            async for _ in facewire.track_async(DEMO):
                pass

        with of_film(frame for frame in [(0.0, PICTURE)]), unittest.mock.patch("facewire._film.track", track):
            asyncio.run(take())
        self.assertEqual(len(loaded), 1)
        self.assertIsNot(loaded[0], threading.current_thread())

    def test_a_consumer_who_leaves_frees_the_camera_and_a_wrong_source_is_an_error(self):
        camera = Camera(itertools.repeat(PICTURE))

        async def leave():
            frames = facewire.track_async(0)
            async for frame in frames:
                break
            await frames.aclose()
            return frame

        with camera.plugged():
            self.assertEqual(asyncio.run(leave()).number, 0)
        self.assertTrue(camera.released.is_set())

        async def take_nothing():
            async for _ in facewire.track_async("/nonexistent.mp4"):
                pass

        with self.assertRaises(FileNotFoundError):
            asyncio.run(take_nothing())


class Batches(unittest.TestCase):
    def test_a_batch_gives_the_faces_of_each_picture_in_order_whatever_it_is(self):
        import PIL.Image

        upright = PIL.Image.fromarray(numpy.ascontiguousarray(bgr(5)[:, :, ::-1]))
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "lying.png")
            exif = PIL.Image.Exif()
            exif[0x0112] = 6
            upright.transpose(PIL.Image.ROTATE_90).save(path, exif=exif)
            nothing = numpy.zeros_like(PICTURE)
            given = [bgr(0), upright, path, nothing, str(path), numpy.hstack([bgr(0), bgr(20)])]
            for hidden, workers in [("cv2", 2), ("PIL", 1)]:
                with without(hidden):
                    # Without Pillow, its pictures are left out.
                    pictures = given if hidden == "cv2" else [given[0], given[2]]
                    found = list(facewire.batch(iter(pictures), workers=workers, max_faces=2))
                wanted = [bgr(0), bgr(5), bgr(5), nothing, bgr(5), given[5]] if hidden == "cv2" else [bgr(0), bgr(5)]
                for place, (faces, picture) in enumerate(zip(found, wanted)):
                    expected = facewire.FaceTracker(stills=True, max_faces=2).process_all(picture)
                    self.assertEqual(len(faces), len(expected), (hidden, place))
                    for face, other in zip(faces, expected):
                        self.assertEqual(face.landmarks.tobytes(), other.landmarks.tobytes(), (hidden, place))
                        self.assertEqual(face.coefficients.tobytes(), other.coefficients.tobytes(), (hidden, place))
                self.assertEqual(len(found), len(wanted))

    def test_a_batch_reads_its_pictures_as_results_are_taken(self):
        read = []

        def pictures():
            for number in range(30):
                read.append(number)
                yield PICTURE

        for taken, _ in enumerate(facewire.batch(pictures(), workers=2), 1):
            self.assertLessEqual(len(read), taken + 5)
        self.assertEqual((taken, len(read)), (30, 30))

    def test_who_leaves_a_batch_does_not_wait_for_pictures_that_nobody_has_begun(self):
        found, begun, is_left = [], threading.Event(), threading.Event()

        def find(_, picture):
            found.append(picture)
            if picture == 1:
                begun.set()
                is_left.wait()
            return []

        class Pool(concurrent.futures.ThreadPoolExecutor):
            def shutdown(self, wait=True, **options):
                super().shutdown(wait=False, **options)
                is_left.set()
                super().shutdown(wait)

        patch = unittest.mock.patch
        with patch("facewire._batch._find", find), patch("concurrent.futures.ThreadPoolExecutor", Pool):
            batch = facewire.batch(range(9), workers=1)
            next(batch)
            begun.wait()
            batch.close()
        self.assertEqual(found, [0, 1])

    def test_what_is_no_picture_of_a_batch_is_an_error(self):
        with self.assertRaisesRegex(TypeError, "give a list"):
            facewire.batch("picture.png")
        for hidden in ("cv2", "PIL"):
            with without(hidden):
                with self.assertRaises(FileNotFoundError):
                    list(facewire.batch(["/nonexistent.png"]))
                with self.assertRaisesRegex(facewire.FacewireError, "test_facewire.py"):
                    list(facewire.batch([__file__]))
        with without("cv2"), without("PIL"), self.assertRaisesRegex(facewire.FacewireError, "pip install pillow"):
            list(facewire.batch([__file__]))


class Drawing(unittest.TestCase):
    face = facewire.FaceTracker(stills=True).process(PICTURE)
    nothing = {"landmarks": False, "contours": False, "bars": False}

    def drawn(self, **what):
        """Draws parts of a face on black, and returns where something was drawn."""
        black = numpy.zeros_like(PICTURE)
        self.assertIs(facewire.draw(black, self.face, **{**self.nothing, **what}), black)
        return black.any(axis=2)

    def test_dots_lie_on_the_landmarks_and_lines_between_those_that_are_connected(self):
        points = self.face.landmarks[:, :2]
        y, x = numpy.nonzero(self.drawn(landmarks=True))
        self.assertTrue(self.drawn(landmarks=True)[tuple(numpy.rint(points[:, ::-1]).astype(int).T)].all())
        self.assertLess(max(numpy.hypot(*(points - pixel).T).min() for pixel in numpy.stack([x, y], axis=1)), 2)
        lines = self.drawn(contours=True)
        for name, edges in facewire.CONNECTIONS.items():
            for middle in points[edges].mean(axis=1):
                left, top = numpy.floor(middle).astype(int)
                self.assertTrue(lines[top:top + 2, left:left + 2].any(), name)
        self.assertFalse(self.drawn().any())

    def test_a_bar_is_as_long_as_its_coefficient(self):
        black = numpy.zeros_like(PICTURE)
        facewire.draw(black, self.face, landmarks=False, contours=False)
        self.assertFalse(black[:, 118:].any())
        for row, value in enumerate(self.face.coefficients):
            # Below the letters.
            self.assertEqual((black[9 * row + 8, :, 0] > 0).sum(), int(118 * value + 0.5), facewire.BLENDSHAPES[row])
            self.assertGreater((black[9 * row:9 * row + 8] == 255).all(axis=2).sum(), 30, "letters")

    def test_faces_are_drawn_in_pictures_of_any_size_and_channels_and_nothing_without_a_face(self):
        for shape in [(480, 640), (480, 640, 1), (480, 640, 4), (960, 1280, 3), (120, 160, 3), (2, 3, 3), (0, 3, 3), (300, 200, 3)]:
            picture = numpy.zeros(shape, numpy.uint8)
            facewire.draw(picture, self.face)
            self.assertTrue(picture.any() or min(shape[:2]) < 100, shape)
            picture[:] = 255
            facewire.draw(picture, self.face)
            if shape[2:] == (4,):
                self.assertTrue((picture[:, :, 3] == 255).all(), "what is opaque stays so")
                self.assertFalse((picture[:, :, :3] == 255).all())
            before = picture.copy()
            facewire.draw(picture, None)
            self.assertEqual(picture.tobytes(), before.tobytes())
        # Of a face that is partly outside of the picture, the rest is drawn as before.
        restore, values = self.face.__reduce__()
        moved = restore(values[0], values[1] - numpy.float32([250, 150, 0]), *values[2:])
        whole, part = numpy.zeros_like(PICTURE), numpy.zeros_like(PICTURE[150:, 250:])
        facewire.draw(whole, self.face, bars=False)
        facewire.draw(part, moved, bars=False)
        self.assertLess((part != whole[150:, 250:]).mean(), 0.001)
        for wrong in (PICTURE.astype(float), PICTURE[None], "picture"):
            with self.assertRaisesRegex(TypeError, "array of uint8"):
                facewire.draw(wrong, self.face)

    def test_parts_are_those_of_mediapipe_and_each_lies_where_its_name_says(self):
        from facewire import _connections

        theirs = {frozenset(edge) for edge in _connections.FACEMESH_CONTOURS | _connections.FACEMESH_IRISES}
        for name, edges in facewire.CONNECTIONS.items():
            ours = {frozenset(edge) for edge in edges.tolist()}
            theirs -= ours
            self.assertEqual({index for edge in ours for index in edge}, set(facewire.PARTS[name].tolist()), name)
        self.assertEqual(theirs, set())
        middle = {name: self.face.landmarks[part, :2].mean(axis=0) for name, part in facewire.PARTS.items()}
        for part in ("eyebrow", "eye", "iris", "pupil"):
            self.assertLess(middle[f"right_{part}"][0], middle[f"left_{part}"][0], "the face looks at the camera")
        heights = [middle[name][1] for name in ("left_eyebrow", "left_eye", "nose_bridge", "nose_base", "outer_lips")]
        self.assertEqual(heights, sorted(heights))
        with self.assertRaises(ValueError):
            facewire.PARTS["left_eye"][0] = 3

    def test_the_points_that_the_document_gives_for_those_of_dlib_lie_in_dlibs_order(self):
        document = (pathlib.Path(os.environ["FACEWIRE_SOURCE"]) / "docs" / "coming-from.md").read_text()
        given = {}
        exec(document.split("```python\n")[1].split("```")[0], given)
        self.assertEqual((len(given["DLIB"]), len(set(given["DLIB"]))), (68, 68))
        x, y = self.face.landmarks[given["DLIB"], :2].T
        for first, end in [(1, 16), (17, 22), (22, 27), (31, 36), (48, 55), (60, 65)]:
            self.assertEqual(sorted(x[first:end]), list(x[first:end]), "to the person's left")
        self.assertEqual(y[:17].argmax(), 8, "the chin")
        self.assertEqual(sorted(y[27:31]), list(y[27:31]))
        middle = self.face.landmarks[[10, 152], 0].mean()
        pairs = [*zip(range(8), range(16, 8, -1)), *zip(range(17, 22), range(26, 21, -1)), (31, 35), (32, 34), (36, 45), (37, 44),
                 (38, 43), (39, 42), (40, 47), (41, 46), (48, 54), (49, 53), (50, 52), (59, 55), (58, 56), (60, 64), (61, 63), (67, 65)]
        for right, left in pairs:
            self.assertLess(abs(x[right] + x[left] - 2 * middle), 12, (right, left))
            self.assertLess(abs(y[right] - y[left]), 8, (right, left))


class Program(unittest.TestCase):
    def run_it(self, *arguments):
        command = [sys.executable, "-m", "facewire", *arguments]
        return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def test_the_table_is_that_of_facewire_track(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "out.csv")
            ran = self.run_it(DEMO, "-o", path)
            self.assertEqual((ran.returncode, ran.stdout), (0, ""))
            self.assertEqual(ran.stderr, "facewire: 240 frames, 240 with a face\n")
            with open(path, newline="") as file, open(EXACT / "demo" / "track.csv", newline="") as other:
                (columns, *ours), (wanted, *theirs) = csv.reader(file), csv.reader(other)
        self.assertEqual((columns, len(ours)), (wanted, len(theirs)))
        self.assertEqual([row[2] for row in ours], [row[2] for row in theirs])
        ours, theirs = (numpy.array([row[:2] + row[3:] for row in rows], float) for rows in (ours, theirs))
        # Another decoder rounds colours otherwise.
        apart = numpy.abs(ours - theirs)
        self.assertLess(apart[:, :2].max(), 1e-5, "numbers and times")
        for first, end, most in [(2, 54, 0.1), (54, 57, 0.5), (57, 60, 2.0), (60, 66, 0.02)]:
            self.assertLess(apart[:, first:end].max(), most, columns[first + 1])
            self.assertLess(apart[:, first:end].mean(), most / 20, columns[first + 1])

    def test_the_first_program_of_both_readmes_shows_every_picture_of_a_camera_with_the_face_drawn(self):
        source = pathlib.Path(os.environ["FACEWIRE_SOURCE"])
        readmes = [source / "README.md", source / "python" / "README.md"]
        first, other = (readme.read_text().split("```python\n")[1].split("```")[0] for readme in readmes)
        self.assertEqual(first, other)
        self.assertLessEqual(len(first.splitlines()), 10)
        with tempfile.TemporaryDirectory() as folder:
            pictures, table, window = (os.path.join(folder, name) for name in ("clip.npy", "out.csv", "window.png"))
            numpy.save(pictures, [bgr(number) for number in range(8)])
            program = pathlib.Path(__file__).with_name("ten_lines.py")
            subprocess.run([sys.executable, program, "--window", window, readmes[1], pictures, table], check=True)
            import PIL.Image

            with PIL.Image.open(window) as shown:
                self.assertEqual(shown.size, (640, 480))

    def test_each_row_is_written_before_the_next_frame_is_read(self):
        from facewire.__main__ import _write

        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "out.csv")

            def frames():
                for number in range(3):
                    yield facewire.TrackedFrame(number, number / 30, None)
                    self.assertEqual(len(path.read_text().splitlines()), number + 2)

            with open(path, "w") as file, contextlib.redirect_stderr(io.StringIO()):
                _write(frames(), file)

    def test_the_program_ends_quietly_when_nobody_reads_the_table_any_more(self):
        reader, writer = os.pipe()
        os.close(reader)
        command, buffered = [sys.executable, "-m", "facewire", DEMO], {**os.environ, "PYTHONUNBUFFERED": ""}
        ran = subprocess.run(command, env=buffered, stdout=writer, stderr=subprocess.PIPE, text=True)
        os.close(writer)
        self.assertEqual((ran.returncode, ran.stderr), (0, ""))

    def test_a_picture_that_is_too_large_and_a_stop_before_the_first_frame_are_one_line(self):
        from facewire.__main__ import main

        def stop():
            raise KeyboardInterrupt
            yield

        large = (frame for frame in [(0.0, numpy.zeros((4097, 8, 3), numpy.uint8))])
        for film, status, line in [(large, 1, "is too large"), (stop(), 130, "stopped before the first frame")]:
            said = io.StringIO()
            with of_film(film), contextlib.redirect_stderr(said):
                self.assertEqual(main([DEMO]), status)
            self.assertRegex(said.getvalue(), f"^facewire: .*{line}.*\n$")

    def test_a_frame_without_a_face_is_neutral(self):
        from facewire.__main__ import _row

        empty = _row(facewire.TrackedFrame(7, 0.25, None))
        self.assertEqual((empty[:3], set(empty[3:])), (["7", "0.250000", "neutral"], {"0.000000"}))

    def test_help_has_examples_and_a_wrong_file_is_one_line_and_leaves_the_table_alone(self):
        self.assertRegex(self.run_it("--help").stdout, r"python -m facewire talk.mp4 -o talk.csv")
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "out.csv")
            path.write_text("kept")
            for wrong, message in [("/nonexistent.mp4", "there is no file /nonexistent.mp4"), (__file__, "cannot be decoded")]:
                ran = self.run_it(wrong, "-o", str(path))
                self.assertEqual((ran.returncode, ran.stdout, ran.stderr.count("\n")), (1, "", 1))
                self.assertIn(message, ran.stderr)
            self.assertEqual(path.read_text(), "kept")


class Faults(unittest.TestCase):
    def test_what_is_no_picture_is_an_exception(self):
        huge = numpy.lib.stride_tricks.as_strided(PICTURE, (5000, 8000, 3), (0, 0, 1))
        cases = [
            (TypeError, None), (TypeError, "film.mp4"), (TypeError, [[1, 2], [3, 4]]), (TypeError, b"\0" * 300),
            (TypeError, PICTURE.astype(numpy.float32)), (TypeError, numpy.full((480, 640, 3), numpy.nan)),
            (TypeError, PICTURE.astype(numpy.int8)), (TypeError, PICTURE.astype(object)), (TypeError, PICTURE > 3),
            (ValueError, numpy.zeros((), numpy.uint8)), (ValueError, PICTURE[0, 0]), (ValueError, PICTURE[None]),
            (ValueError, numpy.zeros((0, 640, 3), numpy.uint8)), (ValueError, numpy.zeros((480, 0, 3), numpy.uint8)),
            (ValueError, numpy.zeros((480, 640, 0), numpy.uint8)), (ValueError, numpy.zeros((480, 640, 5), numpy.uint8)),
            (ValueError, PICTURE.transpose(2, 0, 1)), (ValueError, huge),
            (ValueError, numpy.zeros((4097, 8, 3), numpy.uint8)),
        ]
        tracker = facewire.FaceTracker()
        for wanted, given in cases:
            with self.assertRaises(wanted):
                tracker.process(given, 0.0)
        for wanted, options in [(ValueError, {"format": "jpeg"}), (ValueError, {"format": "i420"}), (ValueError, {"time_s": -1.0}),
                                (ValueError, {"time_s": float("nan")}), (ValueError, {"time_s": 1e300}),
                                (TypeError, {"time_s": "now"}), (TypeError, {"time": 1.0})]:
            with self.assertRaises(wanted, msg=str(options)):
                tracker.process(PICTURE, **options)
        self.assertIsNotNone(tracker.process(PICTURE, 0.0), "the tracker goes on")

    def test_messages_about_pictures_say_what_to_do(self):
        import PIL.Image

        deep = PIL.Image.fromarray(PICTURE[:, :, 0].astype(numpy.uint16) * 257)
        large = numpy.zeros((4097, 12_289, 3), numpy.uint8)
        cases = [
            (deep, {}, "in the mode I;16 have more than 8 bits; scale them"),
            (deep.convert("I"), {}, "in the mode I have more than 8 bits"),
            (deep.convert("F"), {}, "in the mode F have more than 8 bits"),
            (PICTURE, {"format": "jpeg"}, 'format="jpeg" is not known; give one of .*bgr, .*grey, .*i444'),
            (large, {}, r"12289 x 4097 pixels is too large: .* up to 4096 pixels; shrink it by a factor of 4, .*reduce\(4\)"),
            (large[:, :1], {}, "by a factor of 2"),
            (large[:0], {}, "is empty"),
        ]
        for picture, options, message in cases:
            with self.assertRaisesRegex(ValueError, message):
                facewire.FaceTracker().process(picture, **options)
        self.assertIsNone(facewire.FaceTracker().process(PIL.Image.fromarray(large[:, :1]).reduce(2)))

    def test_small_and_odd_pictures_do_no_harm(self):
        tracker = facewire.FaceTracker(max_faces=2)
        for height, width in [(1, 1), (1, 4096), (4096, 1), (3, 5), (129, 127)]:
            self.assertIsNone(tracker.process(numpy.zeros((height, width, 3), numpy.uint8)))
            self.assertIsNone(tracker.process(numpy.zeros((2 * height, 2 * width, 3), numpy.uint8)[::2, ::2][::-1])
                              if 2 * max(height, width) <= 8192 else None)

    def test_options_and_files_are_checked(self):
        for wanted, options in [
            (ValueError, {"max_faces": 0}), (ValueError, {"threads": 99}), (ValueError, {"neutral": "maybe"}),
            (ValueError, {"horizontal_fov_deg": float("nan")}), (TypeError, {"unknown": 1}), (OverflowError, {"max_faces": -1}),
            (facewire.FacewireError, {"profile": "/nonexistent.toml"}), (facewire.FacewireError, {"model": "/nonexistent.toml"}),
            (facewire.FacewireError, {"networks": "/nonexistent"}), (ValueError, {"method": "magic"}),
            (ValueError, {"method": "paper", "model": "/nonexistent.toml"}), (ValueError, {"focal_length_px": 0.0}),
            (ValueError, {"eye_distance_mm": 0.0}), (ValueError, {"settings": "[camera]"}),
            (ValueError, {"settings": "smoothing.jaw_ms = 351"}),
            (ValueError, {"horizontal_fov_deg": float("nan"), "focal_length_px": 500.0}),
        ]:
            with self.assertRaises(wanted, msg=str(options)):
                facewire.FaceTracker(**options)
        for options in [{"stills": True}, {"smoothing": False}]:
            named = ", ".join(f"{name}={value}" for name, value in options.items())
            with self.assertRaisesRegex(ValueError, f"but {named} switches"):
                facewire.FaceTracker(settings="smoothing.jaw_ms = 100", **options)
        with self.assertRaises(FileNotFoundError):
            facewire.track("/nonexistent.mp4")
        with self.assertRaises(ValueError):
            facewire.FaceTracker().set_neutral([])


class Resources(unittest.TestCase):
    def test_memory_does_not_grow_from_frame_to_frame(self):
        tracker, small = facewire.FaceTracker(), numpy.ascontiguousarray(PICTURE[::2, ::2])
        strided = PICTURE[::2, ::2]

        def run(frames):
            for number in range(frames):
                self.assertIsNotNone(tracker.process(strided if number % 2 else small))
                with self.assertRaises(ValueError):
                    tracker.process(PICTURE[None])

        frames = int(os.environ.get("FACEWIRE_LEAK_FRAMES", "400"))
        run(100)
        gc.collect()
        before = memory_mb()
        run(frames)
        # A leak of the landmarks alone would be 2.3 MB in 400 frames.
        self.assertLess(memory_mb() - before, 1.2)

    def test_threads_with_a_tracker_each_find_the_same_and_one_tracker_serves_one_thread(self):
        found, refused = [None] * 4, []

        def run(place):
            tracker = facewire.FaceTracker()
            found[place] = [tracker.process(FILM[number], time_s(number), format="i422").coefficients.tobytes() for number in range(20)]

        threads = [threading.Thread(target=run, args=(place,)) for place in range(4)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        self.assertEqual(found, [[row[:52].tobytes() for row in EXPECTED[:20]]] * 4)

        shared = facewire.FaceTracker(max_faces=16)

        def share():
            # A busy machine may run one thread after the other for a while.
            for _ in range(10_000):
                try:
                    shared.process(PICTURE)
                except RuntimeError:
                    refused.append(True)
                if refused:
                    break

        threads = [threading.Thread(target=share) for _ in range(2)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        self.assertTrue(refused, "two threads were in one tracker at the same time")

    def test_a_forked_child_gets_errors_for_a_tracker_of_its_parent_and_neither_hangs_nor_dies(self):
        code = """
import gc, os, signal, sys, threading, numpy, facewire
tracker, picture, is_over, processed = facewire.FaceTracker(threads=4), numpy.zeros((480, 640, 3), numpy.uint8), [], [0]
def process():
    while not is_over:
        tracker.process(picture)
        processed[0] += 1
def be_a_child(is_last):
    global tracker
    signal.alarm(60)
    for call in (lambda: tracker.process(picture), lambda: tracker.set_neutral([]), tracker.profile, tracker.reset):
        try:
            call()
        except RuntimeError as error:
            assert "make a tracker in the child" in str(error), error
        else:
            raise AssertionError("the call was taken")
    del call
    tracker = None
    gc.collect()
    if is_last:
        assert facewire.FaceTracker().process(picture) is None
thread = threading.Thread(target=process, daemon=True)
thread.start()
for child in range(10):
    before = processed[0]
    while processed[0] == before:
        pass
    identity = os.fork()
    if identity == 0:
        status = 1
        try:
            be_a_child(child == 9)
            status = 0
        finally:
            os._exit(status)
    assert os.waitpid(identity, 0)[1] == 0
is_over.append(True)
thread.join()
print("no child hung")
"""
        ran = subprocess.run([sys.executable, "-W", "ignore", "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.assertEqual((ran.returncode, ran.stdout), (0, "no child hung\n"), ran.stderr)

    def test_other_threads_run_while_a_picture_is_processed(self):
        tracker, counted, stop = facewire.FaceTracker(max_faces=1), [0], threading.Event()

        def count():
            while not stop.is_set():
                counted[0] += 1
                time.sleep(0)

        # A thread that wants the interpreter waits for this long, unless the one that has it lets go.
        interval = sys.getswitchinterval()
        sys.setswitchinterval(100.0)
        thread = threading.Thread(target=count)
        try:
            thread.start()
            before = counted[0]
            end = time.monotonic() + 60
            while time.monotonic() < end:
                tracker.process(PICTURE)
                # A busy machine may not run the other thread within one picture.
                if counted[0] > before:
                    break
            self.assertGreater(counted[0], before)
        finally:
            sys.setswitchinterval(interval)
            stop.set()
            thread.join()

    def test_the_package_needs_numpy_alone_and_is_typed(self):
        code = "import sys, facewire; print([name for name in ('cv2', 'av', 'PIL', 'mediapipe') if name in sys.modules])"
        printed = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout
        self.assertEqual(printed.strip(), "[]")
        folder = pathlib.Path(facewire.__file__).parent
        self.assertTrue((folder / "py.typed").exists() and (folder / "_facewire.pyi").exists())
        (licences,) = (file for file in importlib.metadata.files("facewire") if file.name == "LICENSES.txt")
        self.assertRegex(licences.read_text(), r"(?s)MediaPipe.*\npyo3 [0-9.]+ \(.*Apache License")


if __name__ == "__main__":
    unittest.main()
