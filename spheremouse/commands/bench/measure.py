"""Measure the time of a tracker's step: beside two blob detectors, and for many steps in a row.

Each measurement also counts the frames in which the ball was tracked. A tracker that has lost the ball is fast, and its
times are not valid.
"""

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from spheremouse.ball.build import begin, build
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import BlobSettings, Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import step
from spheremouse.ball.warm import warm_up
from spheremouse.commands.bench import WARM_UP
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.geometry.rotation import Array
from spheremouse.session import messages
from spheremouse.session.offline import initialise
from spheremouse.session.timing import memory_mb
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

STEP, DETECT, FILTER, BLOBS, SIMPLE = "step", "detect", "filter", "blobs", "SimpleBlobDetector"
MEMORY_FROM = 1000  # steps, until the allocator has enough memory
_BLOCK = 30  # frames that one of the compared processes before the next: a second of video
_MAX_FRAME_BYTES = 1 << 29  # of the frames that are played repeatedly

Progress = Callable[[str, int, int], None]  # name of the measurement, steps done, all steps


def silent(what: str, done: int, total: int) -> None:
    """Ignore progress."""


@dataclass(frozen=True, slots=True)
class Film:
    """A film that can be read repeatedly, and the device in it."""

    name: str
    rig: Rig
    interval: float  # s from frame to frame
    frames: Callable[[], Iterator[Frame]]
    count: int  # largest number of frames


@dataclass(frozen=True, slots=True)
class Times:
    """Wall times of all compared stages, for every frame after the warm-up."""

    seconds: dict[str, Array]  # (n,) s of each stage
    tracked: int  # of the n frames

    def __len__(self) -> int:
        return len(self.seconds[STEP])


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps in a row by one tracker, after the warm-up."""

    seconds: Array  # (n,) s, wall time
    processor: Array  # (n,) s, processor time of this thread, without that of other programs
    tracked: int  # of the n steps
    lost: int  # how often the ball was lost
    slowest: str  # events of the slowest step
    grown_mb: float | None = None  # of the resident memory from MEMORY_FROM steps to the end

    def __len__(self) -> int:
        return len(self.seconds)


def simulated(frames: int) -> Film:
    """Return the simulated far scene. With 300 frames the ball is at rest at both ends."""
    fps = SimulationOptions().fps
    film = prepare(SimulationOptions(seconds=frames / fps))
    images = lambda: (made.frame for made in simulate(film))  # noqa: E731
    return Film("simulated far scene", film.scene.rig(), 1.0 / fps, images, film.frames)


def recorded(path: Path, frames: int) -> Film:
    """Return the first `frames` of a dataset; DatasetError if it is none."""
    recording = open_dataset(path)
    count = min(frames, recording.frames)
    interval = 1.0 / recording.fps
    return Film(recording.name, recording.rig, interval, lambda: islice(read_frames(recording), count), count)


def start() -> float:
    """Compile the functions or read them from disk, and return the time in s."""
    began = time.perf_counter()
    warm_up(Settings())
    return time.perf_counter() - began


@contextmanager
def one_thread() -> Iterator[None]:
    """Run OpenCV and the linear algebra on one thread in this block."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(threads)


# ---- comparison on the same frames, one second in turn ----


def compare(film: Film, repeat: int = 1, progress: Progress = silent) -> Times:
    """Measure the tracker and two blob detectors on the same frames; DatasetError if there are too few."""
    rounds = []
    for r in range(repeat):
        done = r * film.count
        rounds.append(_round(film, lambda k, done=done: progress("comparison", done + k, repeat * film.count)))
    seconds = {name: np.concatenate([r.seconds[name] for r in rounds]) for name in rounds[0].seconds}
    return Times(seconds, sum(r.tracked for r in rounds))


def _round(film: Film, progress: Callable[[int], None]) -> Times:
    tracker, frames = _initialised(film)
    blobs = BlobDetector(BlobSettings())
    simple = cv2.SimpleBlobDetector.create()
    state: TrackState | None = None
    spent: dict[str, list[float]] = {name: [] for name in (STEP, DETECT, FILTER, BLOBS, SIMPLE)}
    tracked = 0
    detected = 0.0

    def mark() -> None:
        nonlocal detected
        detected = time.perf_counter()

    def ours(frame: Frame) -> None:
        nonlocal state, detected, tracked
        state = state or begin(tracker, frame.stamp)
        began = detected = time.perf_counter()  # without a call of `mark`, all time counts as the filter's
        state = step(state, frame, tracker, mark).state
        ended = time.perf_counter()
        tracked += len(spent[STEP]) >= WARM_UP and state.status is Status.TRACKING
        for name, s in ((STEP, ended - began), (DETECT, detected - began), (FILTER, ended - detected)):
            spent[name].append(s)

    def timed(name: str, detect: Callable[[NDArray[np.uint8]], Any]) -> Callable[[Frame], None]:
        def run(frame: Frame) -> None:
            began = time.perf_counter()
            detect(frame.image)
            spent[name].append(time.perf_counter() - began)

        return run

    turns = [ours, timed(BLOBS, blobs.detect), timed(SIMPLE, simple.detect)]
    while block := list(islice(frames, _BLOCK)):
        for turn in turns:
            for frame in block:
                turn(frame)
        turns.append(turns.pop(0))  # the first one has the pictures in another cache than the last
        progress(len(spent[STEP]))
    _check_length(film, len(spent[STEP]))
    return Times({name: np.array(s[WARM_UP:]) for name, s in spent.items()}, tracked)


# ---- steps in a row ----


class Player:
    """Tracks a film that is played forwards and backwards without end, with increasing stamps."""

    def __init__(self, film: Film, steps: int) -> None:
        """Prepare for `steps`; DatasetError if the film is too short."""
        self._tracker, frames = _initialised(film)
        size = film.rig.camera.width * film.rig.camera.height * 3
        self._frames = list(islice(frames, max(_MAX_FRAME_BYTES // size, WARM_UP + 1)))
        _check_length(film, len(self._frames))
        self._interval = film.interval
        self._state = begin(self._tracker, self._frames[0].stamp)
        # filled now, since memory that is first used later would look like a leak
        self._times = np.full((2, steps), np.nan)  # wall, processor
        self._status = np.full(steps, Status.TRACKING, dtype=object)
        self._slowest = (0.0, "")
        self._early_mb: float | None = None
        self._done = 0

    def step(self) -> None:
        """Track the next frame."""
        k = self._done
        image = self._frames[back_and_forth(k, len(self._frames))].image
        frame = Frame(image, self._frames[0].stamp + k * self._interval, k)
        used, began = time.thread_time(), time.perf_counter()
        tracked = step(self._state, frame, self._tracker)
        ended, used = time.perf_counter(), time.thread_time() - used
        self._state = tracked.state
        self._status[k] = tracked.state.status
        self._times[:, k] = ended - began, used
        if k >= WARM_UP and ended - began > self._slowest[0]:
            self._slowest = ended - began, messages.line(tracked.events)
        self._done += 1
        if self._done == MEMORY_FROM:
            self._early_mb = memory_mb()

    def steps(self) -> Steps:
        """Return the measurements of all steps."""
        status = self._status[WARM_UP:]
        lost = status == Status.LOST
        lost[1:] &= status[:-1] != Status.LOST
        return Steps(
            *self._times[:, WARM_UP:],
            tracked=int(np.count_nonzero(status == Status.TRACKING)),
            lost=int(np.count_nonzero(lost)),
            slowest=self._slowest[1],
            grown_mb=None if self._early_mb is None else memory_mb() - self._early_mb,
        )


def in_a_row(film: Film, steps: int, progress: Progress = silent) -> Steps:
    """Measure `steps` of the tracker alone; DatasetError if there are too few frames.

    Garbage is collected and frozen before, as in the daemon.
    """
    player = Player(film, steps)
    gc.collect()
    gc.freeze()
    try:
        for k in range(steps):
            player.step()
            progress("step by step", k + 1, steps)
        return player.steps()
    finally:
        gc.unfreeze()


def back_and_forth(k: int, n: int) -> int:
    """Return the index of the k-th frame if `n` are played forwards and backwards: 0, 1, 2, 1, 0, 1 for three."""
    if n == 1:
        return 0
    k %= 2 * (n - 1)
    return min(k, 2 * (n - 1) - k)


def _initialised(film: Film) -> tuple[Tracker, Iterator[Frame]]:
    settings = Settings()
    warm_up(settings)
    begun = initialise(film.frames(), film.rig, settings)
    return build(film.rig, begun.pose, settings), begun.frames


def _check_length(film: Film, frames: int) -> None:
    if frames <= WARM_UP:
        raise DatasetError(f"{film.name}: {frames} frames to track, but the first {WARM_UP} do not count")
