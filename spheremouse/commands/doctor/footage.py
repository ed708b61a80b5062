"""Two seconds of frames: their times, a coarse grid of brightness of each, and a few whole ones."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig
from spheremouse.capture import Source, open_source
from spheremouse.capture.lock import locked
from spheremouse.commands.doctor.controls import Controls, read
from spheremouse.errors import DamagedFrameError, SourceError, SpheremouseError
from spheremouse.geometry.rotation import Array
from spheremouse.session.plan import Plan
from spheremouse.tracker import Frame

GRID = (24, 16)  # rows and columns: fine enough for the bands of a rolling shutter, which are three or four
SETTLING = 0.4  # s after a camera's first frame that are left out, while it finds its exposure
_VIEWS = 10  # whole frames
_FIRST_TIMEOUT = 4.0  # s for a camera to begin
_SILENT_TIMEOUT = 1.0  # s without a frame after which it has stopped
_MAX_FRAMES = 600  # frames: of a recording at 240 Hz


@dataclass(frozen=True, slots=True)
class Footage:
    """Frames and their times."""

    stamps: Array  # (n,) s
    arrivals: Array  # (n,) s on the clock of live stamps
    sequence: Array  # (n,)
    grid: Array  # (n, rows, columns) mean grey
    views: tuple[Frame, ...]
    fps: float | None  # Hz, as promised
    live: bool
    stamped: bool  # stamps are the camera's own
    damaged: int
    notes: tuple[str, ...]  # on stamps, and on the end of the frames
    description: str
    rig: Rig | None  # of the source
    controls: Controls | None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in px."""
        height, width = self.views[0].image.shape[:2]
        return width, height


def film(plan: Plan, seconds: float, node: Path | None, source: Source | None = None) -> Footage:
    """Film a source, which may be open already. SourceError if no frame comes."""
    camera = plan.source.partition(":")[0] == "v4l2"
    with contextlib.nullcontext() if node is None else locked(node):
        return _of_camera(plan, seconds, node) if camera else _of_source(plan, seconds, node, source)


class _Reel:
    """Collects frames."""

    def __init__(self, fps: float | None, seconds: float) -> None:
        self.stamps: list[float] = []
        self.arrivals: list[float] = []
        self.sequence: list[int] = []
        self.grid: list[Image] = []
        self.views: list[Frame] = []
        self.step = max(1, round((fps or 30.0) * seconds / _VIEWS))
        self.damaged = 0

    @property
    def wants_view(self) -> bool:
        return len(self.stamps) % self.step == 0 and len(self.views) <= _VIEWS

    def add(self, frame: Frame, arrival: float) -> None:
        image = frame.image
        if self.wants_view:
            self.views.append(replace(frame, image=image.copy()))
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        self.grid.append(cv2.resize(grey.astype(np.float32), GRID[::-1], interpolation=cv2.INTER_AREA))
        self.stamps.append(frame.stamp)
        self.arrivals.append(arrival)
        self.sequence.append(frame.sequence)

    def developed(
        self, fps: float | None, *, live: bool, stamped: bool, notes: tuple[str, ...], description: str,
        rig: Rig | None, controls: Controls | None,
    ) -> Footage:  # fmt: skip
        if not self.stamps:
            what = f"nothing but {self.damaged} damaged frames" if self.damaged else "no frame"
            raise SourceError(f"{description}: {what}; see cable, hub and power, or take another format")
        return Footage(
            np.array(self.stamps), np.array(self.arrivals), np.array(self.sequence), np.array(self.grid, dtype=float),
            tuple(self.views), fps, live, stamped, self.damaged, notes, description, rig, controls,
        )  # fmt: skip


def _of_camera(plan: Plan, seconds: float, node: Path | None) -> Footage:
    from spheremouse.capture.v4l2 import open_camera

    with contextlib.ExitStack() as stack:
        camera = stack.enter_context(open_camera(plan.source.partition(":")[2], plan.configuration.camera))
        reel = _Reel(camera.fps, seconds)
        notes: tuple[str, ...] = ()
        begun: float | None = None
        while begun is None or time.monotonic() < begun + SETTLING + seconds:
            shot = camera.next(_FIRST_TIMEOUT if begun is None else _SILENT_TIMEOUT)
            now = time.monotonic()
            if shot is None:
                notes = () if begun is None else (f"the frames stopped for {_SILENT_TIMEOUT:g} s",)
                break
            begun = begun or now
            try:
                if now >= begun + SETTLING:
                    reel.add(shot.frame(reel.wants_view), now)
            except DamagedFrameError:
                reel.damaged += 1
            finally:
                shot.release()
        controls = None if node is None else read(node)
        return reel.developed(
            camera.fps, live=True, stamped=True, notes=notes + camera.notes, description=camera.describe(),
            rig=None, controls=controls,
        )  # fmt: skip


def _of_source(plan: Plan, seconds: float, node: Path | None, source: Source | None) -> Footage:
    source = source or open_source(plan.source)
    with contextlib.ExitStack() as stack:
        frames = iter(stack.enter_context(source))
        reel = _Reel(source.fps, seconds)
        notes: tuple[str, ...] = ()
        settled = -np.inf
        try:
            for frame in _bounded(frames, seconds + (SETTLING if source.live else 0.0)):
                settled = frame.stamp + SETTLING if settled == -np.inf and source.live else settled
                if frame.stamp >= settled:
                    reel.add(frame, time.monotonic())
        except SpheremouseError as e:
            if not reel.stamps:
                raise
            notes = (str(e),)
        controls = None if node is None else read(node)
        return reel.developed(
            source.fps, live=source.live, stamped=False, notes=notes, description=plan.source,
            rig=source.rig, controls=controls,
        )  # fmt: skip


def _bounded(frames: Iterator[Frame], seconds: float) -> Iterator[Frame]:
    """Yield the frames of the first seconds by their stamps."""
    first: float | None = None
    for n, frame in enumerate(frames):
        first = frame.stamp if first is None else first
        if frame.stamp > first + seconds or n >= _MAX_FRAMES:
            return
        yield frame
