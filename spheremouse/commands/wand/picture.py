"""Read the picture in which colours are picked."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import ConfigurationError
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.files.pictures import FRAME_PIXELS, MOST_BYTES, decoded, read_header
from spheremouse.files.safe_files import read_bytes


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Return a picture, (h, w, 3) BGR, or the first frame of a wand's dataset.

    Raises ConfigurationError if the file cannot be read, or if its picture is below 32 px.
    """
    if path.is_dir():
        return next(read_frames(open_wand(path))).image
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; name a picture with the ball in it")
    try:
        data = read_bytes(path, MOST_BYTES, "picture")
        read_header(data, FRAME_PIXELS)
        image = decoded(data, upright=True)
    except OSError as e:
        raise ConfigurationError(f"{path}: {e.strerror or e}") from None
    if min(image.shape[:2]) < 32:
        raise ConfigurationError(f"{path}: is {image.shape[1]}x{image.shape[0]} px; too small to show a ball")
    return image
