"""The layout of a dataset folder: names of files and columns, and how images come off the disk."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import DatasetError

FILES = ("scene.json", "video.mkv", "frames", "truth.csv", "discs.csv", "stamps.csv", "rig.yaml", "config.yaml")
MATRIX_COLUMNS = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))  # R_obj_ball by rows
MOTION_COLUMNS = ("frame", "t", *MATRIX_COLUMNS, "wx", "wy", "wz")
TRUTH_COLUMNS = (*MOTION_COLUMNS, "omega", "phi", "kappa")
BLOB_COLUMNS = ("u_blob", "v_blob", "area_px")  # may be empty
STAMP_COLUMNS = ("frame", "t", "sequence", "colour")
DISC_COLUMNS = ("frame", "disc", "u_center", "v_center", *BLOB_COLUMNS, "state")


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
