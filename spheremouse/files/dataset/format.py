"""Names of files and columns of a dataset folder, and readers of its description and tables."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import ConfigDict, Field

from spheremouse.errors import ConfigurationError, DatasetError
from spheremouse.files import plain_json
from spheremouse.files.pictures import FRAME_PIXELS
from spheremouse.files.safe_files import read_text
from spheremouse.files.validate import Part, validate
from spheremouse.files.yaml import Document, refuse_control_characters
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

MAX_BALLS = 8  # in hands: each takes its time in every frame, and two people have four
BALL_FILES = tuple(f"wand-{k + 1}.yaml" for k in range(MAX_BALLS))
FILES = (
    "scene.json", "video.mkv", "frames", "truth.csv", "discs.csv", "stamps.csv", "rig.yaml", "config.yaml", *BALL_FILES,
)  # fmt: skip
MATRIX_COLUMNS = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))  # R_obj_ball by rows
MOTION_COLUMNS = ("frame", "t", *MATRIX_COLUMNS, "wx", "wy", "wz")
TRUTH_COLUMNS = (*MOTION_COLUMNS, "omega", "phi", "kappa")
BLOB_COLUMNS = ("u_blob", "v_blob", "area_px")  # may be empty
STAMP_COLUMNS = ("frame", "t", "sequence", "colour")
MAX_BYTES = 1_000_000  # of scene.json; 10,000 discs have 600,000
MAX_FRAMES = 86_400 * 120  # a day at 120 frames per second: `record` takes no more than a day
DISC_COLUMNS = ("frame", "disc", "u_center", "v_center", *BLOB_COLUMNS, "state")


Positive = Annotated[float, Field(gt=0)]


class Entry(Part):
    """A part of scene.json; unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore")


class CameraEntry(Entry):
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    dist: tuple[float, float, float, float, float]


def camera_description(camera: InteriorOrientation) -> dict[str, Any]:
    """Return a `CameraEntry` for scene.json."""
    intrinsic = dict(zip(("fx", "fy", "cx", "cy"), map(float, camera.intrinsic), strict=True))
    return {**intrinsic, "dist": camera.distortion.tolist()}


class SceneEntry(Entry):
    """Entries of scene.json that every recording has."""

    name: str = ""
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    fps: Positive
    frames: Annotated[int, Field(gt=0, le=MAX_FRAMES)]
    exposure_s: Annotated[float, Field(ge=0)] = 0.0

    def interior_orientation(self, camera: CameraEntry) -> InteriorOrientation:
        c = camera
        return InteriorOrientation(self.width, self.height, c.fx, c.fy, c.cx, c.cy, np.array(c.dist, dtype=float))


Scene = TypeVar("Scene", bound=SceneEntry)


def read_json(path: Path) -> Document:
    """Read scene.json; DatasetError, with the line, if it is invalid."""
    try:
        data = plain_json.loads(read_text(path, MAX_BYTES, "scene.json"), constants=True)
        return Document(f"{path}: ", plain_json.tuples(data))
    except FileNotFoundError:
        raise DatasetError(f"{path}: missing; a dataset needs it") from None
    except OSError as e:
        raise DatasetError(f"{path}: cannot be read: {e.strerror or e}") from None
    except UnicodeDecodeError as e:
        raise DatasetError(f"{path}: cannot be read ({e})") from None
    except ValueError as e:
        line = f", line {e.lineno}" if isinstance(e, json.JSONDecodeError) else ""
        raise DatasetError(f"{path}{line}: not valid JSON ({plain_json.message_of(e)})") from None


def described(document: Document, kind: type[Scene]) -> Scene:
    """Return scene.json as this kind of description; DatasetError has a line for each invalid key."""
    try:
        refuse_control_characters(document)
        return validate(document, kind)
    except ConfigurationError as e:
        raise DatasetError(str(e)) from None


def read_description(folder: Path, read: Callable[[Document], Scene]) -> Scene:
    """Read scene.json of a dataset by `read`; DatasetError if the folder or its images are missing."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; a dataset is a folder with scene.json and video.mkv or frames/")
    scene = read(read_json(folder / "scene.json"))
    if scene.width * scene.height > FRAME_PIXELS:
        most = f"at most {FRAME_PIXELS // 1_000_000} megapixels (8K)"
        raise DatasetError(f"{folder / 'scene.json'}: width, height: {scene.width}x{scene.height}; {most} are read")
    if not (folder / "video.mkv").is_file() and not (folder / "frames").is_dir():
        raise DatasetError(f"{folder}: neither video.mkv nor a folder frames/ is there")
    return scene


def check_frames(path: Path, table: Mapping[str, Array], frames: int) -> None:
    """Raise DatasetError unless the column "frame", (n,), has the numbers 0 to `frames` - 1."""
    number = table["frame"]
    if len(number) != frames:
        rows = f"more than {frames}" if len(number) > frames else len(number)  # those that are more are not read
        raise DatasetError(f"{path}: {rows} rows, but scene.json has {frames} frames")
    wrong = np.flatnonzero(number != np.arange(frames))
    if len(wrong):
        raise DatasetError(f"{path}, row {wrong[0] + 1}: frame {number[wrong[0]]:g} where {wrong[0]} is due")


def check_times(path: Path, stamp: Array) -> None:
    """Raise DatasetError unless the times (n,) of a table increase."""
    not_increasing = np.flatnonzero(np.diff(stamp) <= 0.0)
    if len(not_increasing):
        raise DatasetError(f"{path}, row {not_increasing[0] + 2}: t does not increase")


def rotations(path: Path, table: dict[str, Array], columns: Sequence[str]) -> Array:
    """Take the rotations (n, 3, 3) in nine columns, by rows, out of a table; DatasetError for the first invalid row."""
    R = np.stack([table.pop(c) for c in columns], axis=1).reshape(-1, 3, 3)
    for i in range(len(R)):
        if not is_rotation(R[i]):
            raise DatasetError(f"{path}, row {i + 1}: {columns[0]}..{columns[-1]} is not a rotation")
    return R


def is_rotation(R: Array) -> bool:
    """Return True if (3, 3) is a rotation, within the digits of a table."""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0.0)
