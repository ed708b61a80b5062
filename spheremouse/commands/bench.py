"""`spheremouse bench`: measure the time of the tracker's step on this machine, on one thread, for many steps."""

import gc
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.commands.options import JsonFile
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import DatasetError

if TYPE_CHECKING:
    from spheremouse.ball.rig import Rig
    from spheremouse.ball.state import Tracker
    from spheremouse.geometry.rotation import Array
    from spheremouse.tracker import Frame

WARM_UP = 10  # steps that do not count: caches, allocator and processor clock settle
_DEFAULT_STEPS = 10_000  # a hundred of them are above the 99th percentile
_FILM_FRAMES = 300  # of the simulated film, in which the ball is at rest at both ends
_MAX_FRAME_BYTES = 1 << 29  # of the frames that are played repeatedly
_MIN_TRACKED = 0.95  # of the steps; with fewer the times are not those of tracking
_FRAMES_IN_TURN = 30  # frames that one of the compared processes before the next
_DETECTORS = "the multi-mask detector alone", "cv2.SimpleBlobDetector alone"
_QUANTILES = {"median": 0.5, "p99": 0.99, "max": 1.0}


def bench(
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="DATASET", help="Folder.  [default: the simulated far scene]", show_default=False),
    ] = None,
    steps: Annotated[int, typer.Option(metavar="N", min=WARM_UP + 1, help="Steps in a row.")] = _DEFAULT_STEPS,
    json_file: JsonFile = None,
) -> None:
    """Measure the time of the tracker's step, from the picture to the estimate, on one thread.

    The film is played forwards and backwards, and then beside two blob detectors. The command finds the camera's pose
    before. Pose and the first 10 steps do not count. For another picture size, give a dataset that `simulate --size`
    made.
    """
    import cv2

    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.files.safe_files import write_json

    check_outputs([json_file], [dataset], force=True)
    film = _simulated_film() if dataset is None else _recorded_film(dataset)
    cv2.setNumThreads(1)  # the linear algebra has one in all commands
    with progress_bar(auto_refresh=False) as bar:
        task = bar.add_task("stepping", total=steps)
        progress_steps = max(1, steps // 100)
        found = measure(film, steps, lambda k: k % progress_steps or bar.update(task, completed=k, refresh=True))
    figures = report(film, found)
    if json_file is None or not write_json(json_file, figures):
        print("\n".join(lines(figures)))


@dataclass(frozen=True, slots=True)
class Film:
    name: str
    rig: "Rig"
    interval: float  # s from frame to frame
    frames: "Callable[[], Iterator[Frame]]"


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps in a row by one tracker, after the warm-up."""

    seconds: "Array"  # (n,) s, wall time
    processor: "Array"  # (n,) s, processor time of this thread, without that of other programs
    tracked: int  # of the n steps
    lost: int  # how often the ball was lost
    compared: tuple[float, ...] = ()  # s, medians on the same frames in turn: a step, and each of _DETECTORS


def _simulated_film() -> Film:
    from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

    fps = SimulationOptions().fps
    film = prepare(SimulationOptions(seconds=_FILM_FRAMES / fps))
    return Film("simulated far scene", film.scene.rig(), 1.0 / fps, lambda: (made.frame for made in simulate(film)))


def _recorded_film(path: Path) -> Film:
    from spheremouse.files.dataset.ball import open_dataset
    from spheremouse.files.dataset.frames import read_frames

    recording = open_dataset(path)
    return Film(recording.name, recording.rig, 1.0 / recording.fps, lambda: read_frames(recording))


def measure(film: Film, steps: int, progress: Callable[[int], object] = lambda _: None) -> Steps:
    """Measure steps of the tracker, after a garbage collection and freeze. DatasetError: too few frames."""
    import numpy as np

    from spheremouse.ball.build import begin, build
    from spheremouse.ball.settings import Settings
    from spheremouse.ball.track import step
    from spheremouse.session.offline import initialise
    from spheremouse.tracker import Frame, Status

    settings = Settings()
    start = initialise(film.frames(), film.rig, settings)
    tracker, frames = build(film.rig, start.pose, settings), _fitting(film, start.frames)
    state, first = begin(tracker, frames[0].stamp), frames[0].stamp
    times, status = np.full((2, steps), np.nan), np.full(steps, Status.TRACKING, dtype=object)
    gc.collect()
    gc.freeze()
    try:
        for k in range(steps):
            frame = Frame(frames[back_and_forth(k, len(frames))].image, first + k * film.interval, k)
            used, began = time.thread_time(), time.perf_counter()
            made = step(state, frame, tracker)
            took, used = time.perf_counter() - began, time.thread_time() - used
            state, status[k], times[:, k] = made.state, made.state.status, (took, used)
            progress(k + 1)
    finally:
        gc.unfreeze()
    lost = status[WARM_UP:] == Status.LOST
    lost[1:] &= status[WARM_UP:-1] != Status.LOST
    tracked = int(np.count_nonzero(status[WARM_UP:] == Status.TRACKING))
    lost_times = int(np.count_nonzero(lost))
    return Steps(times[0, WARM_UP:], times[1, WARM_UP:], tracked, lost_times, compare(tracker, frames))


def compare(tracker: "Tracker", frames: "list[Frame]") -> tuple[float, ...]:
    """Return the median times, s, of a step and of two blob detectors on the same frames, 30 of them in turn.

    The detectors only find blobs: that of Wittich (2017, section 3.6.1) with ten grey-value masks, and that of OpenCV
    with its default parameters.
    """
    import cv2
    import numpy as np

    from spheremouse.ball.build import begin
    from spheremouse.ball.published.blobs import BlobDetector
    from spheremouse.ball.settings import BlobSettings
    from spheremouse.ball.track import step

    state, spent = begin(tracker, frames[0].stamp), np.full((3, len(frames)), np.nan)

    def track(frame: "Frame") -> None:
        nonlocal state
        state = step(state, frame, tracker).state

    blobs, simple = BlobDetector(BlobSettings()), cv2.SimpleBlobDetector.create()
    turns = list(enumerate((track, lambda f: blobs.detect(f.image), lambda f: simple.detect(f.image))))
    for first in range(0, len(frames), _FRAMES_IN_TURN):
        for row, run in turns:
            for k, frame in enumerate(frames[first : first + _FRAMES_IN_TURN], first):
                began = time.perf_counter()
                run(frame)
                spent[row, k] = time.perf_counter() - began
        turns.append(turns.pop(0))  # the first one finds the pictures in another cache than the last
    return tuple(np.median(spent[:, WARM_UP:], axis=1).tolist())


def _fitting(film: Film, frames: "Iterator[Frame]") -> "list[Frame]":
    size = film.rig.camera.width * film.rig.camera.height * 3
    found = list(islice(frames, max(_MAX_FRAME_BYTES // size, WARM_UP + 1)))
    if len(found) <= WARM_UP:
        raise DatasetError(f"{film.name}: {len(found)} frames to track, but the first {WARM_UP} do not count")
    return found


def back_and_forth(k: int, n: int) -> int:
    """Return the index of the k-th frame if `n` are played forwards and backwards: 0, 1, 2, 1, 0, 1 for three."""
    k %= 2 * (n - 1)
    return min(k, 2 * (n - 1) - k)


def report(film: Film, steps: Steps) -> dict[str, Any]:
    """Return the figures that --json writes: µs, and the 99th percentile and the slowest over the median."""
    import numpy as np

    us, processor = (
        {name: float(np.quantile(s, q)) * 1e6 for name, q in _QUANTILES.items()}
        for s in (steps.seconds, steps.processor)
    )
    return {
        "dataset": film.name,
        "size": [film.rig.camera.width, film.rig.camera.height],
        "interval_us": film.interval * 1e6,
        "steps": len(steps.seconds),
        "tracked": steps.tracked,
        "lost_episodes": steps.lost,
        "us": us,
        "processor_us": processor,
        "ratios": {name: us[name] / us["median"] for name in ("p99", "max")},
        "compared_us": dict(zip(("step", *_DETECTORS), (1e6 * t for t in steps.compared), strict=False)),
    }


def lines(figures: dict[str, Any]) -> Iterator[str]:
    """Yield the figures as lines of text."""
    (width, height), n, tracked, lost = (figures[key] for key in ("size", "steps", "tracked", "lost_episodes"))
    yield f"{figures['dataset']}, {width}x{height}: {n:,} steps in a row on one thread; times in ms"
    yield f"{'':16}{'median':>8}{'p99':>8}{'worst':>8}"
    for name, us in (("step", figures["us"]), ("processor time", figures["processor_us"])):
        yield f"{name:16}" + "".join(f"{us[quantile] / 1e3:8.2f}" for quantile in _QUANTILES)
    yield f"{'over median':16}{'':8}" + "".join(f"{ratio:7.3g}×" for ratio in figures["ratios"].values())
    own = figures["compared_us"].get("step")
    for name in _DETECTORS if own else ():
        yield f"{name}: {figures['compared_us'][name] / 1e3:.2f}, {figures['compared_us'][name] / own:.1f}× a step"
    yield f"tracked: {tracked:,} of {n:,}; {f'lost {lost} times' if lost else 'never lost'}"
    faster = (figures["interval_us"] / us for us in figures["us"].values())
    yield "faster than real time: {:.1f} times by the median, {:.1f} by the p99, {:.1f} by the slowest".format(*faster)
    if tracked < _MIN_TRACKED * n:
        yield f"warning: tracked in less than {100 * _MIN_TRACKED:.0f} % of the steps, so these times are not valid"
