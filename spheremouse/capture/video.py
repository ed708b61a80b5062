"""`video:PATH`: any video file that OpenCV reads, with the stamps of its container.

Matroska rounds stamps to milliseconds, which at 30 Hz changes each rate by up to 1 %. A stamp within 0.6 ms of a
multiple of the frame interval becomes that multiple. A missing frame stays a longer step.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from spheremouse.capture import Stream, pace
from spheremouse.capture.nodes import probe_path
from spheremouse.errors import SourceError
from spheremouse.files.pictures import open_film
from spheremouse.finding import Finding
from spheremouse.tracker import Frame

_MAX_ROUNDING_ERROR = 0.6e-3  # s: half a millisecond and a margin


def open(argument: str, realtime: bool) -> Stream:
    path = Path(argument)
    if not argument:
        raise SourceError("video: needs a file; write video:PATH")
    if not path.exists():
        raise SourceError(f"{path}: no such file; check the path after video:")
    if not path.is_file():
        raise SourceError(f"{path}: is no file; name a video file, or write dataset:{path} for a dataset folder")
    try:
        capture = open_film(path)
    except OSError as e:
        raise SourceError(f"{path}: {e.strerror or e}") from None
    if capture is None:
        raise SourceError(f"{path}: not a video that OpenCV can read; convert it, for example with ffmpeg to .mkv")
    fps = _positive(capture.get(cv2.CAP_PROP_FPS))
    promised = _positive(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = None if promised is None else round(promised)
    frames = read_frames(capture, path, fps, count)
    return Stream(pace(frames) if realtime else frames, fps=fps, count=count, close=capture.release)


def read_frames(capture: cv2.VideoCapture, path: Path, fps: float | None, count: int | None) -> Iterator[Frame]:
    """Yield the frames. Raises SourceError at the end if the file has none, or fewer than its header promises.

    `fps` and `count` are frames/s and frames by the header; None: unknown.
    """
    read, last = 0, -math.inf
    while True:
        try:
            good, image = capture.read()
        except cv2.error:
            good, image = False, None
        if not good or image is None:
            break
        last = stamp(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0, last, fps)
        yield Frame(np.asarray(image, dtype=np.uint8), last, read)
        read += 1
    if read == 0:
        raise SourceError(f"{path}: holds no frame that can be read; the file is damaged or empty")
    if is_cut_short(read, last, fps, count):
        raise SourceError(f"{path}: ends after {read} of {count} frames; the file is truncated or damaged there")


def stamp(container: float, last: float, fps: float | None) -> float:
    """Return the stamp (s) of a frame from its container's time and the last stamp (-inf: none).

    A time that does not increase or is no number becomes one interval after the last stamp.
    """
    interval = 1.0 / (fps or 30.0)
    if not (math.isfinite(container) and container > last):
        return last + interval if math.isfinite(last) else 0.0
    on_grid = round(container / interval) * interval
    return on_grid if abs(on_grid - container) <= _MAX_ROUNDING_ERROR and on_grid > last else container


def is_cut_short(read: int, last: float, fps: float | None, count: int | None) -> bool:
    """Return True if a video of `count` promised frames stopped early, both in frames and in time.

    The promise is often duration times rate. If the rate varies, frames may be fewer, but the last stamp is at the end.
    A frame or two may always be missing.
    """
    if count is None or fps is None:
        return False
    tolerance = max(2.0, 0.01 * count)
    return count - read > tolerance and count / fps - (last + 1.0 / fps) > tolerance / fps


def _positive(value: float) -> float | None:
    return value if math.isfinite(value) and value > 0 else None


def probe(argument: str) -> list[Finding]:
    return [probe_path(Path(argument))]
