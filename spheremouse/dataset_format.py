"""The layout of a dataset folder: names of files and columns, and how descriptions, tables and images are read."""

import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spheremouse.errors import DatasetError
from spheremouse.rotation import Array

FILES = ("scene.json", "video.mkv", "frames", "truth.csv", "discs.csv", "stamps.csv", "rig.yaml", "config.yaml")
MATRIX_COLUMNS = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))  # R_obj_ball by rows
MOTION_COLUMNS = ("frame", "t", *MATRIX_COLUMNS, "wx", "wy", "wz")
TRUTH_COLUMNS = (*MOTION_COLUMNS, "omega", "phi", "kappa")
BLOB_COLUMNS = ("u_blob", "v_blob", "area_px")  # may be empty
STAMP_COLUMNS = ("frame", "t", "sequence", "colour")
DISC_COLUMNS = ("frame", "disc", "u_center", "v_center", *BLOB_COLUMNS, "state")


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]


class Entry(BaseModel):
    """A part of scene.json; what it does not know, others may have written."""

    model_config = ConfigDict(strict=True, extra="ignore")


class CameraEntry(Entry):
    """The interior orientation."""

    fx: Positive
    fy: Positive
    cx: Number
    cy: Number
    dist: tuple[Number, Number, Number, Number, Number]


class SceneEntry(Entry):
    """What scene.json says of every recording."""

    name: str = ""
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    fps: Positive
    frames: Annotated[int, Field(gt=0)]
    exposure_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0


Scene = TypeVar("Scene", bound=SceneEntry)


def read_json(path: Path) -> Any:
    """The content of scene.json; DatasetError with the line where it is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DatasetError(f"{path}: missing; a dataset needs it") from None
    except (OSError, UnicodeDecodeError) as e:
        raise DatasetError(f"{path}: cannot be read ({e})") from None
    except json.JSONDecodeError as e:
        raise DatasetError(f"{path}, line {e.lineno}: not valid JSON ({e.msg})") from None


def described(path: Path, content: Any, kind: type[Scene]) -> Scene:
    """The content of scene.json as a description of that kind; DatasetError says which key is wrong."""
    try:
        # Through JSON once more, so that lists count as tuples while "640" still does not count as a number.
        return kind.model_validate_json(json.dumps(content))
    except ValidationError as e:
        first = e.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        more = f" (and {e.error_count() - 1} more)" if e.error_count() > 1 else ""
        raise DatasetError(f"{path}: {key}: {first['msg'][0].lower()}{first['msg'][1:]}{more}") from None


def read_description(folder: Path, read: Callable[[Path], Scene]) -> Scene:
    """What `read` makes of a dataset's scene.json; DatasetError where the folder or its pictures are missing."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; a dataset is a folder with scene.json and video.mkv or frames/")
    scene = read(folder / "scene.json")
    if not in_video(folder) and not (folder / "frames").is_dir():
        raise DatasetError(f"{folder}: neither video.mkv nor a folder frames/ is there")
    return scene


def read_table(path: Path, columns: tuple[str, ...], optional: tuple[str, ...] = ()) -> Array:
    """Those columns of a csv file with a header, (n, len(columns)); only `optional` ones may be empty (nan)."""
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            header = next(reader, [])
            missing = [c for c in columns if c not in header]
            if missing:
                raise DatasetError(f"{path}, line 1: no column {', '.join(missing)}")
            places = [header.index(c) for c in columns]
            for cells in reader:
                if not cells:
                    continue
                if len(cells) != len(header):
                    raise DatasetError(
                        f"{path}, line {reader.line_num}: {len(cells)} cells under {len(header)} columns"
                    )
                rows.append(
                    [
                        _cell(path, reader.line_num, c, cells[i], c in optional)
                        for c, i in zip(columns, places, strict=True)
                    ]
                )
    except (OSError, UnicodeDecodeError, csv.Error) as e:
        raise DatasetError(f"{path}: cannot be read ({e})") from None
    return np.array(rows, dtype=float).reshape(-1, len(columns))


def _cell(path: Path, line: int, column: str, text: str, may_be_empty: bool) -> float:
    if may_be_empty and not text.strip():
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DatasetError(f"{path}, line {line}: {column}: {text!r} is not a number")
    return value


def check_rows(path: Path, table: Array, frames: int) -> None:
    """DatasetError unless the table has a row for each frame: its number first, then a time that grows."""
    if len(table) != frames:
        raise DatasetError(f"{path}: {len(table)} rows, but scene.json says {frames} frames")
    for i in range(frames):
        if table[i, 0] != i:
            raise DatasetError(f"{path}, row {i + 1}: frame {table[i, 0]:g} where {i} is due")
        if i and table[i, 1] <= table[i - 1, 1]:
            raise DatasetError(f"{path}, row {i + 1}: t does not increase")


def is_rotation(R: Array) -> bool:
    """Is (3, 3) a rotation, to what tables are written with?"""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0.0)


def in_video(folder: Path) -> bool:
    """Are the pictures of a dataset in a video, or in files?"""
    return (folder / "video.mkv").is_file()


def recorded_images(folder: Path, size: tuple[int, int], frames: int) -> Iterator[NDArray[np.uint8]]:
    """A dataset's pictures in their order, (h, w, 3) blue, green, red, for `size` (w, h) px and so many `frames`.

    A recording cut short gives what is there and then raises DatasetError.
    """
    source, images = folder / "frames", folder_images(folder)
    if in_video(folder):
        source = folder / "video.mkv"
        images = video_images(source)
    width, height = size
    count = 0
    for image in images:
        h, w = image.shape[:2]
        if (w, h) != size:
            raise DatasetError(f"{source}: frame {count} is {w}x{h}, but scene.json says {width}x{height}")
        yield image
        count += 1
        if count == frames:
            return
    if count == 0:
        raise DatasetError(f"{source}: no frame in it can be read")
    raise DatasetError(f"{source}: ends after {count} of {frames} frames")


def picture_file(folder: Path, index: int) -> Path:
    """Where a dataset keeps a picture that is not in its video."""
    return folder / "frames" / f"{index:06d}.png"


def video_images(path: Path) -> Iterator[NDArray[np.uint8]]:
    """The frames of a video as far as they can be read, (h, w, 3) blue, green, red."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        while capture.isOpened():
            ok, image = capture.read()
            if not ok:
                return
            yield np.asarray(image, dtype=np.uint8)
    finally:
        capture.release()


def folder_images(folder: Path) -> Iterator[NDArray[np.uint8]]:
    """frames/000000.png, 000001.png, ... of a dataset up to the first that is missing, (h, w, 3)."""
    index = 0
    while (file := picture_file(folder, index)).is_file():
        yield read_picture(file)
        index += 1


def read_picture(file: Path) -> NDArray[np.uint8]:
    """A picture file, (h, w, 3) blue, green, red."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise DatasetError(f"{file}: not an image that can be read")
    return np.asarray(image, dtype=np.uint8)
