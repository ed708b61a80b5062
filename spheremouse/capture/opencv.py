"""`opencv:INDEX[,width=W,height=H,fps=F]`: a live camera through OpenCV, on any operating system.

A stamp is the time of the fetch by time.monotonic(), made steady. It is later than mid-exposure, by half the exposure,
the readout and the transfer, typically 10 to 40 ms.
"""

import contextlib
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from spheremouse.capture import Stream
from spheremouse.capture.nodes import nodes, probe_node
from spheremouse.capture.steady import SteadyStamps
from spheremouse.errors import SourceError
from spheremouse.files.pictures import open_capture
from spheremouse.files.registry import options
from spheremouse.finding import Finding
from spheremouse.tracker import Frame

_USUAL_FPS = 30.0  # frames/s, if the camera names none
_PROPERTIES = {"width": cv2.CAP_PROP_FRAME_WIDTH, "height": cv2.CAP_PROP_FRAME_HEIGHT, "fps": cv2.CAP_PROP_FPS}


def open(argument: str, realtime: bool) -> Stream:  # a camera is always real time
    """Open camera number INDEX. Raises SourceError if it does not open, or has not the size in `argument`."""
    index, wanted = check(argument)
    capture = open_capture(int(index))
    if capture is None:
        raise SourceError(
            f"opencv:{index}: no camera there, or another program uses it, or it may not be opened; "
            "see `ls -l /dev/video*` and whether you are in the group video"
        )
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # frames that wait in a queue would get late stamps
    for name, value in wanted.items():
        capture.set(_PROPERTIES[name], float(value))
    for name in ("width", "height"):
        if name in wanted and round(capture.get(_PROPERTIES[name])) != wanted[name]:
            given = f"{capture.get(_PROPERTIES['width']):g}x{capture.get(_PROPERTIES['height']):g}"
            capture.release()
            raise SourceError(f"opencv:{index}: the camera gives {given} instead; ask for a size it has")
    rate = capture.get(cv2.CAP_PROP_FPS)
    fps = rate if math.isfinite(rate) and rate > 0 else None
    return Stream(read_frames(capture, index, 1.0 / (fps or _USUAL_FPS)), live=True, fps=fps, close=capture.release)


def check(argument: str) -> tuple[str, dict[str, int | float | str]]:
    """Return INDEX and the requested properties. Raises SourceError if the argument is invalid."""
    index, _, rest = argument.partition(",")
    if not index.strip().isdecimal():
        raise SourceError(f"opencv:{argument}: needs the number of a camera; write opencv:0 for the first")
    return index, options(rest, {"width": int, "height": int, "fps": float}, f"opencv:{argument}", SourceError)


def probe(argument: str) -> list[Finding]:
    index, _ = check(argument)
    return probe_node(Path(f"/dev/video{int(index)}"), nodes()) if sys.platform.startswith("linux") else []


def read_frames(capture: cv2.VideoCapture, index: str, interval: float) -> Iterator[Frame]:
    """Yield frames of a nominal interval, s. Raises SourceError when the camera delivers no more."""
    sequence, steady = 0, SteadyStamps(interval)
    while True:
        image, stamp = None, 0.0
        with contextlib.suppress(cv2.error):
            grabbed = capture.grab()
            stamp = time.monotonic()
            image = capture.retrieve()[1] if grabbed else None
        if image is None:
            raise SourceError(
                f"opencv:{index}: the camera delivers no frame after {sequence}; is it plugged in, "
                "and does another program use it?"
            )
        yield Frame(np.asarray(image, dtype=np.uint8), steady.next(stamp, time.monotonic()), sequence)
        sequence += 1
