"""Read the frames of a recording with the stamps, numbers and colours that the tracker had."""

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

    stamp: Array  # (n,) s, on any clock; may decrease
    sequence: NDArray[np.int64]  # (n,) of the camera's frames; gaps are dropped frames
    colour: NDArray[np.bool_]  # (n,) the tracker had this frame in colour


def read_stamps(folder: Path, frames: int) -> Stamps | None:
    """Read stamps.csv of a dataset with this number of `frames`; None without the file, DatasetError if invalid."""
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
    """Return True if any of the numbers (n,) is not whole."""
    return bool(np.any((column != np.rint(column)) | (np.abs(column) > 2**53)))


def recorded_frames(
    folder: Path, size: tuple[int, int], frames: int, fps: float, times: Array | None, stamps: Stamps | None
) -> Iterator[Frame]:
    """Yield the frames in order, of `size` (w, h) px, with stamp, number and colour from `stamps`.

    Without `stamps` they are in colour, counted from 0, with stamps from `times`, (n,) s, or index / fps. A truncated
    recording yields its frames and then raises DatasetError.
    """
    video = in_video(folder)
    for count, image in enumerate(recorded_images(folder, size, frames)):
        if stamps is not None:
            yield _as_recorded(folder, image, count, stamps, video)
        else:
            yield Frame(image, count / fps if times is None else float(times[count]), count)


def _as_recorded(folder: Path, image: NDArray[np.uint8], index: int, stamps: Stamps, in_video: bool) -> Frame:
    """Return a frame of the video (h, w, 3), or in its place the colour image of a file, or its grey."""
    if not stamps.colour[index]:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)  # the channels are equal
    elif in_video and (file := picture_file(folder, index)).is_file():
        image = read_picture(file, (image.shape[1], image.shape[0]))
    return Frame(image, float(stamps.stamp[index]), int(stamps.sequence[index]))
