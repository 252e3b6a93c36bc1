"""The drawings of the documents, which scripts/draw makes."""

from . import faces, flow, landmarks, scenes, windows, wiring


def drawings(root):
    """Returns all drawings. `root` is the folder of the project, from which one of them reads."""
    return [
        flow.flow(),
        *wiring.drawings(),
        *faces.drawings(),
        *scenes.drawings(),
        *windows.drawings(),
        landmarks.landmarks(root),
    ]
