import os
from typing import Any, Dict, List, Literal, Optional, Tuple, Union

import numpy as np
import numpy.typing as npt

__version__: str
BLENDSHAPES: Tuple[str, ...]

Format = Literal["bgr", "rgb", "bgra", "rgba", "grey", "yuyv", "nv12", "i420", "i422", "i444"]
Path = Union[str, "os.PathLike[str]"]

class FacewireError(Exception): ...

class Face:
    @property
    def id(self) -> int: ...
    @property
    def landmarks(self) -> npt.NDArray[np.float32]: ...
    @property
    def coefficients(self) -> npt.NDArray[np.float32]: ...
    @property
    def blendshapes(self) -> Dict[str, float]: ...
    @property
    def yaw_pitch_roll_deg(self) -> Tuple[float, float, float]: ...
    @property
    def rotation_xyzw(self) -> Tuple[float, float, float, float]: ...
    @property
    def position_mm(self) -> Tuple[float, float, float]: ...
    @property
    def gaze_yaw_pitch_deg(self) -> Tuple[float, float]: ...
    @property
    def neutral(self) -> str: ...
    def __getitem__(self, name: str) -> float: ...

class FaceTracker:
    def __new__(
        cls,
        *,
        max_faces: int = 1,
        stills: bool = False,
        smoothing: bool = True,
        neutral: Optional[Literal["auto", "off"]] = None,
        profile: Optional[Path] = None,
        mirror: bool = False,
        horizontal_fov_deg: float = 60.0,
        model: Optional[Path] = None,
        networks: Optional[Path] = None,
        threads: int = 1,
    ) -> "FaceTracker": ...
    def process(self, frame: Any, time: Optional[float] = None, *, format: Optional[Format] = None) -> Optional[Face]: ...
    def process_all(self, frame: Any, time: Optional[float] = None, *, format: Optional[Format] = None) -> List[Face]: ...
    def set_neutral(self, faces: List[Face]) -> None: ...
    def reset(self) -> None: ...
