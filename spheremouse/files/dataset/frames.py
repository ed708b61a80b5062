"""Read the frames of a recording with the stamps, numbers and colours that the tracker had."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import DatasetError, os_errors_as
from spheremouse.files.dataset.format import STAMP_COLUMNS, SceneEntry, check_frames
from spheremouse.files.pictures import FRAME_PIXELS, decode, film_images, film_size, open_film, px, read_header
from spheremouse.files.pictures import MAX_BYTES as PICTURE_BYTES
from spheremouse.files.safe_files import read_bytes
from spheremouse.files.tables import read_columns
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame


@dataclass(frozen=True, slots=True)
class Stamps:
    """Stamps and numbers that a live camera gave its n frames."""

    stamp: Array  # (n,) s, on any clock; may decrease
    sequence: NDArray[np.int64]  # (n,) of the camera's frames; gaps are dropped frames
    colour: NDArray[np.bool_]  # (n,) the tracker had this frame in colour


def read_stamps(folder: Path, frames: int) -> Stamps | None:
    """Read stamps.csv, None without it. DatasetError unless its rows are the `frames` from 0 on with valid numbers."""
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
    return bool(np.any((column != np.rint(column)) | (np.abs(column) > 2**53)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """Fields of every recording. `read_frames` yields its frames."""

    path: Path
    name: str
    camera: InteriorOrientation
    fps: float  # nominal frames/s
    frames: int
    exposure_s: float
    stamps: Stamps | None = None  # of the live camera; None without stamps.csv
    truth_times: Array | None = None  # (frames,) s, of the truth

    @property
    def seconds(self) -> Array:
        """Stamps of the frames, (frames,) s: recorded ones, else those of the truth, else index / fps."""
        if self.stamps is not None:
            return self.stamps.stamp
        return np.arange(self.frames) / self.fps if self.truth_times is None else self.truth_times


def recorded_fields(
    path: Path, scene: SceneEntry, camera: InteriorOrientation, truth_times: Array | None
) -> dict[str, Any]:
    """Return the fields of `Recorded`, with those of stamps.csv."""
    return {
        "path": path,
        "name": scene.name or path.name,
        "camera": camera,
        "fps": scene.fps,
        "frames": scene.frames,
        "exposure_s": scene.exposure_s,
        "stamps": read_stamps(path, scene.frames),
        "truth_times": truth_times,
    }


def read_frames(recording: Recorded) -> Iterator[Frame]:
    """Yield the frames in order, with stamp, number and colour of the recording.

    Without stamps.csv they are in colour and counted from 0. A truncated recording yields its frames and then raises
    DatasetError.
    """
    folder, stamps, seconds = recording.path, recording.stamps, recording.seconds
    video = (folder / "video.mkv").is_file()
    size = recording.camera.width, recording.camera.height
    for count, image in enumerate(recorded_images(folder, size, recording.frames)):
        if stamps is not None:
            yield _as_recorded(folder, image, count, stamps, video)
        else:
            yield Frame(image, float(seconds[count]), count)


def _as_recorded(folder: Path, image: NDArray[np.uint8], index: int, stamps: Stamps, in_video: bool) -> Frame:
    """Return a frame of the video (h, w, 3), or in its place the colour image of a file, or its grey."""
    if not stamps.colour[index]:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)  # the channels are equal
    elif in_video and (file := picture_file(folder, index)).is_file():
        image = read_picture(file, (image.shape[1], image.shape[0]))
    return Frame(image, float(stamps.stamp[index]), int(stamps.sequence[index]))


def recorded_images(folder: Path, size: tuple[int, int], frames: int) -> Iterator[NDArray[np.uint8]]:
    """Yield this number of images in order, (h, w, 3) blue, green, red, for `size` (w, h) px.

    A truncated recording yields its images and then raises DatasetError. An image of another size raises it undecoded.
    """
    source, images = folder / "frames", folder_images(folder, size)
    if (folder / "video.mkv").is_file():
        source = folder / "video.mkv"
        images = video_images(source, size)
    count = 0
    for count, image in enumerate(islice(images, frames), 1):  # noqa: B007  counted
        yield image
    if count == 0:
        raise DatasetError(f"{source}: no frame in it can be read")
    if count < frames:
        raise DatasetError(f"{source}: ends after {count} of {frames} frames")


def picture_file(folder: Path, index: int) -> Path:
    """Return the path of a frame's image file: of each frame without a video, of colour frames beside one."""
    return folder / "frames" / f"{index:06d}.png"


def video_images(path: Path, size: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """Yield the readable frames of a video, (h, w, 3) blue, green, red; DatasetError for another `size`."""
    with os_errors_as(DatasetError, f"{path}"):
        capture = open_film(path)
    if capture is None:
        return
    if film_size(capture) != size:  # before all of it is decoded
        raise DatasetError(f"{path}: frame 0 is {px(film_size(capture))}, but scene.json has {px(size)}")
    yield from film_images(capture)


def folder_images(folder: Path, size: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """Yield frames/000000.png, 000001.png, ... up to the first missing one, (h, w, 3)."""
    index = 0
    while (file := picture_file(folder, index)).is_file():
        yield read_picture(file, size)
        index += 1


def read_picture(file: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read an image file, (h, w, 3) blue, green, red; DatasetError if its header has another `size`."""
    with os_errors_as(DatasetError, f"{file}"):
        data = read_bytes(file, PICTURE_BYTES, "picture")
        header = read_header(data, FRAME_PIXELS)
        if header.size != size:
            raise DatasetError(f"{file}: is {px(header.size)}, but scene.json has {px(size)}")
        return decode(data)
