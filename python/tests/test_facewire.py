"""The promises of the Python package. FACEWIRE_EXACT names a folder in which the example `exact` has written a folder for each film."""

import collections.abc
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
        tracker.reset()
        self.assertIsNotNone(tracker.process(PICTURE, 0.0))

    def test_what_is_known_of_a_wearer_goes_out_as_a_text_and_comes_back_from_it_or_from_its_file(self):
        tracker = facewire.FaceTracker()
        face = tracker.process(PICTURE, 0.0)
        self.assertIsNone(tracker.profile())
        for number in range(1, 100):
            face = tracker.process(PICTURE, 0.1 * number)
        self.assertEqual(face.neutral, "estimated")
        text = tracker.profile()
        self.assertRegex(text, r"(?s)format = 1\n.*jawOpen = ")
        self.assertIsNone(tracker.profile(face.id + 1))
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

    def test_the_position_follows_from_the_focal_length_and_the_distance_of_the_pupils(self):
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
        with unittest.mock.patch("facewire._film._decode", lambda _: iter(pictures)):
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
        self.assertEqual(both[0]._replace(time_s=1.0).faces, ())

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
        with unittest.mock.patch("facewire._film._decode", lambda _: iter(pictures)):
            first, second = (list(facewire.track(DEMO, tracker)) for _ in range(2))
        for frames in (first, second):
            self.assertEqual([frame.time_s for frame in frames], [0.0, 0.5, 1.0, 1.0, 1.25, 1.5])
        for one, other in zip(first, second):
            self.assertEqual(one.face.coefficients.tobytes(), other.face.coefficients.tobytes())

    def test_the_pictures_of_a_video_may_be_any_time_apart(self):
        pictures = [(10.0 * number, PICTURE) for number in range(8)]
        with unittest.mock.patch("facewire._film._decode", lambda _: iter(pictures)):
            frames = list(facewire.track(DEMO))
        self.assertEqual([frame.time_s for frame in frames], [time_s for time_s, _ in pictures])

    def test_the_times_of_stills_are_not_read(self):
        tracker = facewire.FaceTracker(stills=True)
        for time_s in (3.0, 1.0, None, 1e6, 2e6, 3e6, 4e6, 5e6, 6e6):
            self.assertIsNotNone(tracker.process(PICTURE, time_s))


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
        ]:
            with self.assertRaises(wanted, msg=str(options)):
                facewire.FaceTracker(**options)
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
