"""Programs written for MediaPipe, and its own landmarks of the built-in clip (tests/golden)."""

import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest
import unittest.mock

import numpy

import facewire.mediapipe_compat as mp
from test_facewire import FILM, PICTURE, bgr

THEIRS = pathlib.Path(os.environ["FACEWIRE_SOURCE"]) / "tests" / "golden" / "demo-landmarks.npy"
# The bounds that tests/golden.rs has for the service, too. Both must see the same pixels, here those of FFmpeg: MediaPipe's own
# points move by more if OpenCV decodes the clip, or if only the colours are rounded otherwise.
MEAN_PX, WORST_PX = 0.3, 1.5


class FaceMesh(unittest.TestCase):
    def test_landmarks_are_those_of_mediapipe_within_the_stated_bounds(self):
        theirs = numpy.load(THEIRS) / 32
        with mp.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True) as mesh:
            distances = []
            for number in range(len(FILM)):
                found = mesh.process(bgr(number)[:, :, ::-1]).multi_face_landmarks[0].landmark
                if number % 8 == 0:
                    ours = numpy.array([[point.x * 640, point.y * 480] for point in found])
                    distances.append(numpy.hypot(*(ours - theirs[number // 8][:, :2]).T))
        distances = numpy.array(distances)
        print(f"\nFaceMesh: {distances.mean():.3f} px in the mean, {distances.max():.2f} at most, {len(distances)} frames")
        self.assertLess(distances.mean(), MEAN_PX)
        self.assertLess(distances.max(), WORST_PX)

    def test_a_picture_without_a_face_and_an_array_that_is_none(self):
        mesh = mp.solutions.face_mesh.FaceMesh(static_image_mode=True, min_detection_confidence=0.7)
        self.assertIsNone(mesh.process(numpy.zeros((48, 64, 3), numpy.uint8)).multi_face_landmarks)
        found = mesh.process(PICTURE[:, :, ::-1]).multi_face_landmarks
        self.assertEqual(len(found[0].landmark), 468)
        with self.assertRaises(ValueError):
            mesh.process(PICTURE[:, :, 0])
        mesh.close()
        with self.assertRaises(ValueError):
            mesh.process(PICTURE)

    def test_faces_are_drawn(self):
        face = mp.solutions.face_mesh.FaceMesh(refine_landmarks=True).process(PICTURE[:, :, ::-1]).multi_face_landmarks[0]
        styles, drawn = mp.solutions.drawing_styles, PICTURE.copy()
        for edges, style in [
            (mp.solutions.face_mesh.FACEMESH_TESSELATION, styles.get_default_face_mesh_tesselation_style()),
            (mp.solutions.face_mesh.FACEMESH_CONTOURS, styles.get_default_face_mesh_contours_style()),
            (mp.solutions.face_mesh.FACEMESH_IRISES, styles.get_default_face_mesh_iris_connections_style()),
        ]:
            before = drawn.copy()
            mp.solutions.drawing_utils.draw_landmarks(
                image=drawn, landmark_list=face, connections=edges, landmark_drawing_spec=None, connection_drawing_spec=style
            )
            self.assertTrue((before != drawn).any())
        self.assertIn((168, 6), styles.get_default_face_mesh_contours_style(1))

    def test_landmarks_become_pixels_and_those_outside_of_the_picture_none(self):
        to_pixels = mp.solutions.drawing_utils._normalized_to_pixel_coordinates
        self.assertEqual([to_pixels(0.5, 0.999, 640, 480), to_pixels(1.0, 0.0, 640, 480)], [(320, 479), (639, 0)])
        self.assertEqual([to_pixels(1.1, 0.5, 640, 480), to_pixels(0.5, -0.1, 640, 480)], [None, None])


class FaceLandmarker(unittest.TestCase):
    def options(self, mode="IMAGE", **more):
        vision = mp.tasks.vision
        return vision.FaceLandmarkerOptions(
            base_options=mp.tasks.BaseOptions(model_asset_path="face_landmarker.task"),
            running_mode=getattr(vision.RunningMode, mode), output_face_blendshapes=True,
            output_facial_transformation_matrixes=True, **more,
        )

    def test_results_have_mediapipes_names_order_and_axes(self):
        import facewire

        with mp.tasks.vision.FaceLandmarker.create_from_options(self.options()) as landmarker:
            image = mp.Image(image_format=mp.ImageFormat.SRGB, data=PICTURE[:, :, ::-1])
            found = landmarker.detect(image)
        self.assertEqual(len(found.face_landmarks[0]), 478)
        shapes = found.face_blendshapes[0]
        self.assertEqual([shape.index for shape in shapes], list(range(52)))
        self.assertEqual([shapes[0].category_name, shapes[25].category_name, shapes[51].category_name], ["_neutral", "jawOpen", "noseSneerRight"])
        face = facewire.FaceTracker(stills=True).process(PICTURE)
        for shape in shapes[1:]:
            self.assertEqual(shape.score, face[shape.category_name])
        (matrix,) = found.facial_transformation_matrixes
        self.assertEqual(matrix.shape, (4, 4))
        numpy.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, numpy.eye(3), atol=1e-5)
        # Seen by a camera with MediaPipe's angle of view, the middle of the eyes is where it is in the picture.
        middle = matrix @ [0, 2.62, 3.47, 1]
        seen = middle[:2] / -middle[2] * 240 / math.tan(math.radians(63 / 2)) * [1, -1] + [320, 240]
        numpy.testing.assert_allclose(seen, face.landmarks[[33, 133, 263, 362], :2].mean(axis=0), atol=2)
        json.dumps(matrix[0, 3])
        # What MediaPipe 0.10.14 finds there.
        numpy.testing.assert_allclose(matrix[:3, 3], [0.08, 1.63, -29.63], atol=1)
        # The line from the right eye to the left one points along the head's x axis.
        point = face.landmarks
        across = (point[263] - point[33]) * [1, -1, -1]
        self.assertGreater(across @ matrix[:3, 0] / numpy.linalg.norm(across), 0.98)
        self.assertEqual(mp.tasks.vision.face_landmarker.Blendshapes.MOUTH_SMILE_LEFT, 44)

    def test_films_and_cameras_go_by_their_times(self):
        image = mp.Image(image_format=mp.ImageFormat.SRGB, data=PICTURE[:, :, ::-1])
        film = mp.tasks.vision.FaceLandmarker.create_from_options(self.options("VIDEO"))
        self.assertTrue(film.detect_for_video(image, 33).face_landmarks)
        for wrong in (lambda: film.detect_for_video(image, 33), lambda: film.detect(image),
                      lambda: film.detect_for_video(image, 66, object())):
            with self.assertRaises(ValueError):
                wrong()
        # As with MediaPipe, pictures can be any time apart, and the tracker is given their true times.
        with unittest.mock.patch.object(film, "_tracker", unittest.mock.Mock(wraps=film._tracker)) as tracker:
            for time_ms in range(10_000, 100_000, 10_000):
                self.assertTrue(film.detect_for_video(image, time_ms).face_landmarks)
        given_s = [call.args[1] for call in tracker.process_all.call_args_list]
        self.assertEqual(given_s, [float(time_s) for time_s in range(10, 100, 10)])
        called = []
        live = self.options("LIVE_STREAM", result_callback=lambda result, image, time_ms: called.append((result, time_ms)))
        mp.tasks.vision.FaceLandmarker.create_from_options(live).detect_async(image, 7)
        self.assertEqual(called[0][1], 7)
        with self.assertRaises(ValueError):
            self.options("LIVE_STREAM")

    def test_names_and_values_are_those_of_mediapipe_1_2_3(self):
        vision = mp.tasks.vision
        self.assertEqual(mp.__version__, "1.2.3")
        self.assertEqual([mp.tasks.BaseOptions.Delegate(number).name for number in range(3)], ["DEFAULT", "CPU", "GPU"])
        nose = {tuple(edge) for edge in vision.FaceLandmarksConnections.FACE_LANDMARKS_NOSE}
        self.assertTrue({(168, 6), (4, 1), (98, 97)} <= nose and len(nose) == 25)
        with vision.FaceLandmarker.create_from_options(self.options()) as landmarker:
            whole = vision.ImageProcessingOptions(rotation_degrees=0)
            image = mp.Image(mp.ImageFormat.SRGB, PICTURE[:, :, ::-1])
            point = landmarker.detect(image, whole).face_landmarks[0][0]
            with self.assertRaises(ValueError):
                landmarker.detect(image, vision.ImageProcessingOptions(rotation_degrees=90))
        self.assertEqual((point.visibility, point.presence, point.name), (None, None, None))
        mesh = mp.solutions.face_mesh.FaceMesh().process(PICTURE[:, :, ::-1]).multi_face_landmarks[0]
        self.assertEqual((mesh.landmark[0].visibility, mesh.landmark[0].HasField("visibility")), (0.0, False))

    def test_a_picture_tells_its_samples_and_takes_grey_ones_with_a_channel(self):
        image = mp.Image(image_format=mp.ImageFormat.SRGB, data=PICTURE)
        self.assertEqual((image[3, 4, 1], image.step, image.uses_gpu(), image.is_empty()), (PICTURE[3, 4, 1], 1920, False, False))
        self.assertTrue(image.is_contiguous())
        with mp.tasks.vision.FaceLandmarker.create_from_options(self.options()) as landmarker:
            for grey in (PICTURE[:, :, 1], PICTURE[:, :, 1:2]):
                self.assertTrue(landmarker.detect(mp.Image(mp.ImageFormat.GRAY8, grey)).face_landmarks)
        for kind, wrong in [(mp.ImageFormat.SRGBA, PICTURE), (mp.ImageFormat.GRAY16, PICTURE), (mp.ImageFormat.GRAY8, PICTURE[0, 0])]:
            with self.assertRaisesRegex(ValueError, f"is no picture of {kind.name}"):
                mp.Image(kind, wrong)

    def test_a_program_that_imports_mediapipe_in_many_ways_runs_with_its_first_import_changed(self):
        program = """
from facewire.mediapipe_compat import solutions
import mediapipe as mp
from mediapipe.framework.formats import landmark_pb2
from mediapipe.python.solutions.face_mesh import FaceMesh
from mediapipe.tasks import python
from mediapipe.tasks.python import vision
from mediapipe.tasks.python.vision.core.vision_task_running_mode import VisionTaskRunningMode
from mediapipe.tasks.python.vision.core.image import Image
from mediapipe.tasks.python.vision.core.image_processing_options import ImageProcessingOptions
from mediapipe.tasks.python.vision.face_landmarker import FaceLandmarker
from mediapipe.tasks.python.components.containers.landmark import Landmark
import mediapipe.python.solutions.drawing_utils as drawing
import numpy
options = vision.FaceLandmarkerOptions(base_options=python.BaseOptions(model_asset_path="x"), num_faces=1,
                                       running_mode=VisionTaskRunningMode.IMAGE)
detector = vision.FaceLandmarker.create_from_options(options)
assert not detector.detect(mp.Image(mp.ImageFormat.SRGB, numpy.zeros((9, 9, 3), numpy.uint8))).face_landmarks
proto = landmark_pb2.NormalizedLandmarkList()
proto.landmark.extend([landmark_pb2.NormalizedLandmark(x=1, y=2, z=3)])
assert proto.landmark[0].y == 2
assert mp.solutions is solutions
"""
        subprocess.run([sys.executable, "-c", program], check=True)

    def test_a_mediapipe_that_is_installed_stays_itself_until_install(self):
        program = """
import facewire.mediapipe_compat as ours
import mediapipe
assert mediapipe.of_google
ours.install()
import mediapipe
from mediapipe.tasks.python import vision
assert mediapipe is ours and vision is ours.tasks.vision
"""
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / "mediapipe.py").write_text("of_google = True")
            path = os.pathsep.join([folder, os.environ.get("PYTHONPATH", "")])
            subprocess.run([sys.executable, "-c", program], check=True, env={**os.environ, "PYTHONPATH": path})

    def test_a_mediapipe_that_is_found_after_the_import_is_taken(self):
        program = """
import sys
import facewire.mediapipe_compat
sys.path.append(sys.argv[1])
import mediapipe
assert mediapipe.of_google
"""
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / "mediapipe.py").write_text("of_google = True")
            subprocess.run([sys.executable, "-c", program, folder], check=True)

    def test_a_printed_result_shows_its_points(self):
        with mp.tasks.vision.FaceLandmarker.create_from_options(self.options()) as landmarker:
            found = landmarker.detect(mp.Image(mp.ImageFormat.SRGB, PICTURE[:, :, ::-1]))
        self.assertEqual(str(found).count("NormalizedLandmark(x="), 478)
        self.assertEqual(str(found).count("category_name="), 52)


if __name__ == "__main__":
    unittest.main()
