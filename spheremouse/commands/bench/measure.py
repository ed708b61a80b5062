"""What a step of the tracker costs: beside two blob detectors, for hours on end, and in larger pictures.

The measuring behind `spheremouse bench`. Films go in, wall times come out, and whether the ball was tracked all along:
a tracker that has lost it is quick, and worth nothing.
"""

import gc
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.blobs import BlobDetector, BlobSettings
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import step
from spheremouse.ball.warm import warm_up
from spheremouse.commands.bench.series import (
    BLOBS,
    BLOCK,
    COMPARED,
    DETECT,
    FILTER,
    MEMORY_FROM,
    SIMPLE,
    SIZES,
    STEP,
    WARM_UP,
)
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset, read_frames
from spheremouse.geometry.rotation import Array
from spheremouse.session import messages
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

_KEPT = 1 << 29  # bytes of frames that are played again and again; the others are left out
_SIZE_FRAMES, _SIZE_STEPS = 80, 600
_THESIS = 10.0  # s, the simulated motion: at rest at either end, so that it can be played back and forth

Progressed = Callable[[str, int, int], None]  # what is being done, how many are done, of how many


def silent(what: str, done: int, total: int) -> None:
    """Progress that nobody looks at."""


@dataclass(frozen=True, slots=True)
class Film:
    """A film to measure on: frames that can be had again, and the device they show."""

    name: str
    rig: Rig
    interval: float  # s from frame to frame
    frames: Callable[[], Iterator[Frame]]
    count: int  # of the frames, or fewer


@dataclass(frozen=True, slots=True)
class Times:
    """Wall times of every frame after the warm-up, of all that was compared."""

    seconds: dict[str, Array]  # (n,) s of each thing measured
    tracked: int  # of the n frames

    def __len__(self) -> int:
        return len(self.seconds[STEP])


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps in a row by one tracker, after the warm-up."""

    seconds: Array  # (n,) s, wall time
    processor: Array  # (n,) s, of this thread: what others on the machine took is not in it
    tracked: int  # of the n steps
    lost: int  # how often the ball was lost
    slowest: str  # what changed in the slowest step, in the tracker's words
    memory: tuple[int, int] | None = None  # bytes resident after MEMORY_FROM steps and at the end; None: not known

    def __len__(self) -> int:
        return len(self.seconds)


def simulated(frames: int) -> Film:
    """The simulated far scene; with 300 frames the ball is at rest at either end."""
    simulation = prepare(SimulationOptions(seconds=frames / SimulationOptions().fps))
    return Film(
        "simulated far scene",
        simulation.scene.rig(),
        1.0 / simulation.fps,
        lambda: (made.frame for made in simulate(simulation)),
        simulation.frames,
    )


def recorded(path: Path, frames: int) -> Film:
    """The first `frames` of a dataset; DatasetError where it is none."""
    recording = open_dataset(path)
    count = min(frames, recording.frames)
    return Film(
        recording.name,
        recording.rig,
        1.0 / recording.fps,
        lambda: islice(read_frames(recording), count),
        count,
    )


def start() -> float:
    """s that the compiled functions take until they are ready: compiled at the first start, read from disk later."""
    began = time.perf_counter()
    warm_up(Settings())
    return time.perf_counter() - began


# ---- compared: all see the same frames, a second of them in turn ----


def compare(film: Film, repeat: int = 1, progress: Progressed = silent) -> Times:
    """Times of the tracker and, on the same frames, of the two blob detectors; DatasetError on too few frames."""
    rounds = []
    for r in range(repeat):
        done = r * film.count
        rounds.append(_round(film, lambda k, done=done: progress("beside others", done + k, repeat * film.count)))
    seconds = {name: np.concatenate([r.seconds[name] for r in rounds]) for name in COMPARED}
    return Times(seconds, sum(r.tracked for r in rounds))


def _round(film: Film, progress: Callable[[int], None]) -> Times:
    tracker, frames = _initialised(film)
    blobs = BlobDetector(BlobSettings())
    simple = cv2.SimpleBlobDetector.create()
    state: TrackState | None = None
    spent: dict[str, list[float]] = {name: [] for name in COMPARED}
    tracked = 0
    detected = 0.0

    def mark() -> None:
        nonlocal detected
        detected = time.perf_counter()

    def ours(frame: Frame) -> None:
        nonlocal state, detected, tracked
        state = state or begin(tracker, frame.stamp)
        began = detected = time.perf_counter()  # a frame that is not looked at in stages counts as filtered
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
    while block := list(islice(frames, BLOCK)):
        for turn in turns:
            for frame in block:
                turn(frame)
        turns.append(turns.pop(0))  # who comes first finds the pictures in another cache than who comes last
        progress(len(spent[STEP]))
    _enough(film, len(spent[STEP]))
    return Times({name: np.array(s[WARM_UP:]) for name, s in spent.items()}, tracked)


# ---- steps in a row: the film forwards and backwards, again and again ----


class Player:
    """A film that never ends, tracked step by step: played forwards and backwards, while its stamps go on."""

    def __init__(self, film: Film, steps: int) -> None:
        """Room for the times of `steps`; DatasetError on a film that is too short."""
        self._tracker, frames = _initialised(film)
        size = film.rig.camera.width * film.rig.camera.height * 3
        self._frames = list(islice(frames, max(_KEPT // size, WARM_UP + 1)))
        _enough(film, len(self._frames))
        self._interval = film.interval
        self._state = begin(self._tracker, self._frames[0].stamp)
        self._seconds = np.full(steps, np.nan)  # written now: memory that is first used later would seem to leak
        self._processor = np.full(steps, np.nan)
        self._tracked = np.zeros(steps, dtype=bool)
        self._lost = np.zeros(steps, dtype=bool)
        self._slowest = (0.0, "")
        self._memory: int | None = None
        self._done = 0

    def step(self) -> None:
        """The next frame."""
        k = self._done
        image = self._frames[back_and_forth(k, len(self._frames))].image
        frame = Frame(image, self._frames[0].stamp + k * self._interval, k)
        before = self._state.status
        used, began = time.thread_time(), time.perf_counter()
        made = step(self._state, frame, self._tracker)
        ended, used = time.perf_counter(), time.thread_time() - used
        self._state, status = made.state, made.state.status
        self._tracked[k] = status is Status.TRACKING
        self._lost[k] = status is Status.LOST and before is not Status.LOST
        if k >= WARM_UP and ended - began > self._slowest[0]:
            self._slowest = ended - began, messages.line(made.events)
        self._seconds[k], self._processor[k] = ended - began, used
        self._done += 1
        if self._done == MEMORY_FROM:
            self._memory = resident_bytes()

    def steps(self) -> Steps:
        """Measurements so far."""
        counted = slice(WARM_UP, self._done)
        memory = resident_bytes() if self._done > MEMORY_FROM else None
        return Steps(
            self._seconds[counted],
            self._processor[counted],
            int(np.count_nonzero(self._tracked[counted])),
            int(np.count_nonzero(self._lost[counted])),
            self._slowest[1],
            None if self._memory is None or memory is None else (self._memory, memory),
        )


def in_a_row(film: Film, steps: int, progress: Progressed = silent) -> Steps:
    """Times of `steps` of the tracker alone, from the first frame on; DatasetError on too few frames."""
    player = Player(film, steps)
    with collected():
        for k in range(steps):
            player.step()
            progress("step by step", k + 1, steps)
        return player.steps()


def by_size(
    sizes: Sequence[tuple[int, int]] = SIZES,
    frames: int = _SIZE_FRAMES,
    steps: int = _SIZE_STEPS,
    progress: Progressed = silent,
) -> dict[tuple[int, int], Steps]:
    """Times of the tracker in the simulated far scene, by the size of the picture: step by step in turn.

    The view is the same in all, the focal length in pixels goes with the size. The camera's pose is known here: how it
    is found has nothing to do with what a step costs.
    """
    players: dict[tuple[int, int], Player] = {}
    for k, size in enumerate(sizes):
        progress("larger pictures: filming", k, len(sizes))
        players[size] = Player(_whole_motion(frames, size), steps)
    turns = list(players.values())
    with collected():
        for k in range(steps):
            for player in turns:
                player.step()
            turns.append(turns.pop(0))
            progress("larger pictures", k + 1, steps)
    return {size: player.steps() for size, player in players.items()}


def _whole_motion(frames: int, size: tuple[int, int]) -> Film:
    """The simulated motion from rest to rest in a few frames, shown at the usual rate: the ball rolls faster."""
    simulation = prepare(SimulationOptions(seconds=_THESIS, fps=frames / _THESIS, size=size))
    rig = replace(simulation.scene.rig(), pose=simulation.scene.pose)
    shown = 1.0 / SimulationOptions().fps
    return Film("far scene", rig, shown, lambda: (made.frame for made in simulate(simulation)), simulation.frames)


def back_and_forth(k: int, n: int) -> int:
    """Index of the k-th frame when `n` are played forwards and backwards: 0, 1, 2, 1, 0, 1 for three."""
    if n == 1:
        return 0
    k %= 2 * (n - 1)
    return min(k, 2 * (n - 1) - k)


@contextmanager
def collected() -> Iterator[None]:
    """Garbage thrown away, and what is left taken out of the collector's sight: libraries' objects by the 100,000.

    The collector goes on, but finds only what the steps themselves leave behind. The daemon does the same.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def resident_bytes() -> int | None:
    """Memory of this process that is in RAM; None where the system has no /proc (Linux alone does)."""
    if not sys.platform.startswith("linux"):
        return None
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV on one thread for a while."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _initialised(film: Film) -> tuple[Tracker, Iterator[Frame]]:
    settings = Settings()
    warm_up(settings)
    begun = initialise(film.frames(), film.rig, settings)
    return build(film.rig, begun.pose, settings), begun.frames


def _enough(film: Film, frames: int) -> None:
    if frames <= WARM_UP:
        raise DatasetError(f"{film.name}: {frames} frames to track, and the first {WARM_UP} do not count")
