"""Sources: where frames come from. `KIND:ARGUMENT` in, a context manager that yields Frames out.

A source is a module here with `open(argument: str, realtime: bool) -> Source`; its name, one of `KINDS`, is its kind.
Those of other distributions are named by entry points in the group `spheremouse.source`.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from spheremouse.ball.rig import Rig
from spheremouse.errors import SourceError
from spheremouse.files.registry import opened
from spheremouse.tracker import Frame

KINDS = ("dataset", "opencv", "synthetic", "v4l2", "video")


class Source(Protocol):
    """An iterator of frames that is closed by leaving its `with` block. Ends, or raises SourceError (a live one)."""

    @property
    def rig(self) -> Rig | None:
        """The device as the source itself knows it, if it does."""
        ...

    @property
    def live(self) -> bool:
        """Frames come when they are taken, and those not fetched in time are lost."""
        ...

    @property
    def fps(self) -> float | None:
        """Nominal frames per second, for display only: time steps come from the stamps."""
        ...

    @property
    def count(self) -> int | None:
        """Number of frames to come, as far as the source can promise."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


class RawFrame(Protocol):
    """A picture as a live camera gave it, not decoded yet."""

    @property
    def stamp(self) -> float:
        """s on the clock of time.monotonic(), mid-exposure of the middle row."""
        ...

    @property
    def sequence(self) -> int:
        """Counts every frame the camera produced: a gap shows what the driver dropped."""
        ...

    def frame(self, colour: bool) -> Frame:
        """Decode: (h, w) luma, or (h, w, 3) BGR; perhaps a view of the buffer, good until `release`.

        Raises DamagedFrameError where this is no whole picture.
        """
        ...

    def release(self) -> None:
        """Give the buffer back, from any thread, once or more often."""
        ...


class Camera(Protocol):
    """A live source as the daemon takes it: raw frames one by one; closed by leaving its `with` block."""

    def next(self, timeout: float) -> RawFrame | None:
        """The next raw frame, None where none came within `timeout` s; SourceError where the camera is gone."""
        ...

    def describe(self) -> str:
        """Device, format, size, rate and what was set, in one line."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


@dataclass(frozen=True, slots=True)
class Stream:
    """The plain source: an iterator of frames, what is known of it, and how to close it."""

    frames: Iterator[Frame]
    rig: Rig | None = None
    live: bool = False
    fps: float | None = None
    count: int | None = None
    close: Callable[[], None] | None = None

    def __iter__(self) -> Iterator[Frame]:
        return self.frames

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.close is not None:
            self.close()


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
    """The source that `KIND:ARGUMENT` names; `realtime` gives recorded frames no sooner than their stamps say."""
    members = ("rig", "live", "fps", "count", "__iter__", "__enter__", "__exit__")
    return opened(sys.modules[__name__], "source", spec, SourceError, members, realtime)


def paced(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The frames, each held back until the time since the first one is what the stamps say; none is dropped."""
    ahead: float | None = None  # clock less stamp, at the first frame
    for frame in frames:
        now = time.monotonic()
        if ahead is None:
            ahead = now - frame.stamp
        time.sleep(max(0.0, frame.stamp + ahead - now))
        yield frame
