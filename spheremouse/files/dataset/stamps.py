"""The frames of a recording as they were tracked: each with its stamp and number, in grey or in colour."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import DatasetError
from spheremouse.files.dataset.format import (
    STAMP_COLUMNS,
    check_frames,
    in_video,
    picture_file,
    read_picture,
    recorded_images,
)
from spheremouse.files.tables import read_columns
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame


@dataclass(frozen=True, slots=True)
class Stamps:
    """Stamps and numbers that a live camera gave its n frames."""

    stamp: Array  # (n,) s, on any clock; not even sure to grow
    sequence: NDArray[np.int64]  # (n,) of the camera's frames: gaps are frames that were dropped
    colour: NDArray[np.bool_]  # (n,) the tracker was given this one in colour


def read_stamps(folder: Path, frames: int) -> Stamps | None:
    """stamps.csv of a dataset of so many `frames`; None where there is none. DatasetError where it is wrong."""
    path = folder / "stamps.csv"
    if not path.exists():
        return None
    table = read_columns(path, STAMP_COLUMNS, most=frames)
    check_frames(path, table, frames)
    sequence, colour = table.pop("sequence"), table.pop("colour")
    if fractional(sequence) or np.any(sequence < 0.0):
        raise DatasetError(f"{path}: sequence must be a whole number, 0 or more")
    if not np.all((colour == 0.0) | (colour == 1.0)):
        raise DatasetError(f"{path}: colour must be 0 or 1")
    return Stamps(table["t"], sequence.astype(np.int64), colour == 1.0)


def fractional(column: Array) -> bool:
    """Is a number of (n,) not a whole one?"""
    return bool(np.any((column != np.rint(column)) | (np.abs(column) > 2**53)))


def recorded_frames(
    folder: Path, size: tuple[int, int], frames: int, fps: float, times: Array | None, stamps: Stamps | None
) -> Iterator[Frame]:
    """The frames in order, of `size` (w, h) px, each with stamp and number, in grey or colour, as `stamps` say.

    Where there are none, they are in colour, counted from 0, and stamped from `times`, (n,) s, or index / fps.

    A recording cut short gives what is there and then raises DatasetError.
    """
    video = in_video(folder)
    for count, image in enumerate(recorded_images(folder, size, frames)):
        if stamps is not None:
            yield _as_recorded(folder, image, count, stamps, video)
        else:
            yield Frame(image, count / fps if times is None else float(times[count]), count)


def _as_recorded(folder: Path, image: NDArray[np.uint8], index: int, stamps: Stamps, in_video: bool) -> Frame:
    """A picture of the video (h, w, 3), or what stands for it: one in colour of its own file, or its grey."""
    if not stamps.colour[index]:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)  # of equal channels: their value
    elif in_video and (file := picture_file(folder, index)).is_file():
        image = read_picture(file, (image.shape[1], image.shape[0]))
    return Frame(image, float(stamps.stamp[index]), int(stamps.sequence[index]))
