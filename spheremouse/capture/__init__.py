"""Sources: `KIND:ARGUMENT` opens a context manager that yields frames.

A source is a module of this package with `open(argument: str, realtime: bool) -> Source`. Its name is in `KINDS`. Other
distributions add sources by entry points in the group `spheremouse.source`.
"""

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, Self

from spheremouse.ball.rig import Rig
from spheremouse.errors import SourceError
from spheremouse.files import registry
from spheremouse.finding import Finding
from spheremouse.tracker import Frame

KINDS = ("dataset", "opencv", "synthetic", "v4l2", "video")


class Source(Protocol):
    """An iterator of frames, closed by leaving its `with` block. A recording ends; a live source raises SourceError."""

    @property
    def rig(self) -> Rig | None:
        """The device; None if the source does not contain it."""
        ...

    @property
    def live(self) -> bool:
        """True for a camera. Its frames are lost unless the program fetches them in time."""
        ...

    @property
    def fps(self) -> float | None:
        """Nominal frames per second, for display only; None if unknown. Time steps come from the stamps."""
        ...

    @property
    def count(self) -> int | None:
        """Number of frames, or None if the source cannot report it."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> bool | None: ...


class Payload(NamedTuple):
    """An image as a camera sent it. The data is a view, valid until the frame is released."""

    format: Literal["jpeg", "yuyv", "nv12", "grey", "bgr"]
    width: int  # px
    height: int  # px
    data: memoryview  # contiguous bytes: a JPEG file, or rows without padding


class RawFrame(Protocol):
    """An image of a live camera that is not decoded yet."""

    @property
    def stamp(self) -> float:
        """Mid-exposure of the middle row, s on the clock of time.monotonic()."""
        ...

    @property
    def sequence(self) -> int:
        """Number of the frame among all that the camera produced. A gap shows frames that the driver dropped."""
        ...

    def frame(self, colour: bool) -> Frame:
        """Decode to (h, w) luma or (h, w, 3) BGR. The image may be a view of the buffer, valid until `release`.

        Raises DamagedFrameError if the image is incomplete.
        """
        ...

    def payload(self) -> Payload:
        """Return the image as it was sent, which may be damaged. Raises DamagedFrameError if bytes are missing."""
        ...

    def release(self) -> None:
        """Return the buffer to the driver, from any thread. A second call does nothing."""
        ...


class Camera(Protocol):
    """A live source that returns raw frames one by one, closed by leaving its `with` block."""

    def next(self, timeout: float) -> RawFrame | None:
        """Return the next raw frame; None if none comes within `timeout` (s). Raises SourceError if it is gone."""
        ...

    def describe(self) -> str:
        """Return device, format, size, rate and changed controls in one line."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> bool | None: ...


OpenCamera = Callable[[], AbstractContextManager[Camera]]


@dataclass(frozen=True, slots=True)
class Stream:
    """A source made of an iterator of frames and a function that closes it."""

    frames: Iterator[Frame]
    rig: Rig | None = None
    live: bool = False
    fps: float | None = None  # nominal frames/s; None: unknown
    count: int | None = None  # frames; None: unknown
    close: Callable[[], None] | None = None

    def __iter__(self) -> Iterator[Frame]:
        return self.frames

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.close is not None:
            self.close()


def section(frames: Iterable[Frame], begin: float, end: float = math.inf) -> Iterator[Frame]:
    """Yield the frames from `begin` to before `end`, in s after the first one."""
    zero: float | None = None
    for frame in frames:
        zero = frame.stamp if zero is None else zero
        if frame.stamp - zero >= end:
            return
        if frame.stamp - zero >= begin:
            yield frame


def full_spec(spec: str) -> str:
    """Return `KIND:ARGUMENT` for a path that needs no kind: a camera's node, a folder with a recording, or a film.

    For example, /dev/video0 becomes v4l2:/dev/video0, and demo/play becomes dataset:demo/play.
    """
    if spec.startswith(("/dev/video", "/dev/v4l/")):
        return f"v4l2:{spec}"
    if spec in KINDS:
        return spec
    if os.path.isfile(os.path.join(spec, "scene.json")):  # False, other than of Path, for every impossible name
        return f"dataset:{spec}"
    return f"video:{spec}" if os.path.isfile(spec) else spec


def open_source(spec: str, *, realtime: bool = False) -> Source:
    """Open the source `KIND:ARGUMENT`. With `realtime`, recorded frames come no earlier than by their stamps."""
    members = ("rig", "live", "fps", "count", "__iter__", "__enter__", "__exit__")
    return registry.open_spec(sys.modules[__name__], "source", spec, SourceError, members, realtime)


def probe(spec: str) -> list[Finding]:
    """Return findings about the camera or the file of a source `KIND:ARGUMENT`. It is not opened."""
    return registry.probe(sys.modules[__name__], "source", spec, SourceError)


def pace(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield all frames at the pace of their stamps."""
    offset: float | None = None  # s, clock minus stamp of the first frame
    for frame in frames:
        now = time.monotonic()
        if offset is None:
            offset = now - frame.stamp
        time.sleep(max(0.0, frame.stamp + offset - now))
        yield frame
