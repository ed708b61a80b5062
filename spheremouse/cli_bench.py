"""`spheremouse bench`: what a frame costs on this machine, beside the published detector and OpenCV's own, in one run.

All that is compared sees the same frames, turn by turn within each frame, so that a busy machine slows all alike. One
thread: OpenCV is told so, and BLAS reads OMP_NUM_THREADS when NumPy is imported, so that the measurement runs in a
process of its own that has it from the start.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from spheremouse.detect.blobs import BlobDetector, BlobSettings
from spheremouse.errors import ConfigurationError, DatasetError
from spheremouse.frame import Frame
from spheremouse.recording import open_dataset, read_frames
from spheremouse.rig import Rig
from spheremouse.rotation import Array
from spheremouse.session import initialise
from spheremouse.simulate import SimulationOptions, prepare, simulate
from spheremouse.track import Phase, Settings, TrackState, begin, build, step
from spheremouse.warm import warm_up
from spheremouse.yaml_file import write_atomically

EXAMPLE = "Example: spheremouse bench --frames 100 --json speed.json"
WARM_UP = 10  # frames: caches, the allocator and the processor's clock settle; said wherever figures are
STEP, DETECT, FILTER, BLOBS, SIMPLE = "step", "detect", "filter", "blobs", "SimpleBlobDetector"
_NAMES = {
    STEP: "step: detect and filter",
    DETECT: "  its detect stage",
    FILTER: "  its filter stage",
    BLOBS: "multi-mask detector alone",
    SIMPLE: "cv2.SimpleBlobDetector alone",
}
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Film:
    """What is measured on: frames that can be had again, and the device they show."""

    name: str
    rig: Rig
    interval: float  # s from frame to frame
    frames: Callable[[], Iterator[Frame]]


@dataclass(frozen=True, slots=True)
class Times:
    """Wall times of every frame after the warm-up."""

    seconds: dict[str, Array]  # (n,) s of each thing measured
    tracked: int  # of the n frames: a tracker that has lost the ball is quick, and worth nothing

    def __len__(self) -> int:
        return len(self.seconds[STEP])


def bench(
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="DATASET", help="Folder.  [default: the simulated far scene]", show_default=False),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", min=WARM_UP + 1, help="Use the first N frames.")] = 300,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
    repeat: Annotated[int, typer.Option(metavar="R", min=1, help="Go through the frames R times.")] = 1,
) -> None:
    """Measure the time per frame: the default tracker, its stages, and two blob detectors beside it, on one thread.

    The camera's pose is found first and not counted, nor are the first 10 frames; every other frame is.
    """
    if not any(name in os.environ for name in _THREADS):
        command = [sys.executable, "-m", "spheremouse", *sys.argv[1:]]
        child = subprocess.run(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False)
        raise typer.Exit(child.returncode if child.returncode >= 0 else 128 - child.returncode)
    if json_file is not None and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    film = _simulated(frames) if dataset is None else _recorded(dataset, frames)
    figures = report(film, measure(film, repeat), repeat)
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    console = Console(soft_wrap=True)
    console.print(_table(figures))
    for line in _conclusions(figures):
        console.print(line, highlight=False)
    if json_file is not None:
        write_atomically(json_file, text)


def _simulated(frames: int) -> Film:
    options = SimulationOptions(seconds=frames / SimulationOptions().fps)
    simulation = prepare(options)
    return Film(
        "simulated far scene",
        simulation.scene.rig(),
        1.0 / simulation.fps,
        lambda: (made.frame for made in simulate(simulation)),
    )


def _recorded(path: Path, frames: int) -> Film:
    recording = open_dataset(path)
    return Film(
        recording.name,
        recording.rig,
        1.0 / recording.fps,
        lambda: islice(read_frames(recording), min(frames, recording.frames)),
    )


def measure(film: Film, repeat: int = 1) -> Times:
    """Times of the default tracker and, on the same frames, of the two blob detectors; DatasetError on too few."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rounds = [_round(film) for _ in range(repeat)]
    finally:
        cv2.setNumThreads(threads)
    seconds = {name: np.concatenate([r.seconds[name] for r in rounds]) for name in _NAMES}
    return Times(seconds, sum(r.tracked for r in rounds))


def _round(film: Film) -> Times:
    settings = Settings()
    start = initialise(film.frames(), film.rig, settings)
    warm_up(settings)
    tracker = build(film.rig, start.pose, settings)
    blobs = BlobDetector(BlobSettings())
    simple = cv2.SimpleBlobDetector.create()
    state: TrackState | None = None
    spent: dict[str, list[float]] = {name: [] for name in _NAMES}
    tracked = 0

    def ours(frame: Frame) -> None:
        nonlocal state
        state = state or begin(tracker, frame.stamp)
        marks: list[float] = []
        began = time.perf_counter()
        state, _ = step(state, frame, tracker, lambda: marks.append(time.perf_counter()))
        ended = time.perf_counter()
        detected = marks[0]
        for name, s in ((STEP, ended - began), (DETECT, detected - began), (FILTER, ended - detected)):
            spent[name].append(s)

    def timed(name: str, detect: Callable[[NDArray[np.uint8]], Any]) -> Callable[[Frame], None]:
        def run(frame: Frame) -> None:
            began = time.perf_counter()
            detect(frame.image)
            spent[name].append(time.perf_counter() - began)

        return run

    turns = [ours, timed(BLOBS, blobs.detect), timed(SIMPLE, simple.detect)]
    for frame in start.frames:
        for turn in turns:
            turn(frame)
        turns.append(turns.pop(0))  # who comes first finds the picture in another cache than who comes last
        assert state is not None
        tracked += len(spent[STEP]) > WARM_UP and state.phase is Phase.TRACKING
    if len(spent[STEP]) <= WARM_UP:
        raise DatasetError(f"{film.name}: {len(spent[STEP])} frames to track, and the first {WARM_UP} do not count")
    return Times({name: np.array(s[WARM_UP:]) for name, s in spent.items()}, tracked)


# ---- figures ----


def report(film: Film, times: Times, repeat: int) -> dict[str, Any]:
    """What --json writes: µs, and ratios of medians."""
    us = {
        name: {
            "median": float(np.median(s)) * 1e6,
            "p99": float(np.quantile(s, 0.99)) * 1e6,
            "max": float(np.max(s)) * 1e6,
            "share_of_interval": float(np.median(s)) / film.interval,
        }
        for name, s in times.seconds.items()
    }
    step = us[STEP]["median"]
    return {
        "dataset": film.name,
        "size": [film.rig.camera.width, film.rig.camera.height],
        "frames": len(times),
        "repeat": repeat,
        "warm_up": WARM_UP,
        "tracked": times.tracked,
        "interval_us": film.interval * 1e6,
        "threads": {"OpenCV": "1", **{name: os.environ[name] for name in _THREADS if name in os.environ}},
        "us": us,
        "step_to_blobs": step / us[BLOBS]["median"],
        "step_to_SimpleBlobDetector": step / us[SIMPLE]["median"],
        "times_faster_than_real_time": film.interval * 1e6 / step,
    }


def _table(figures: dict[str, Any]) -> Table:
    width, height = figures["size"]
    threads = ", ".join(f"{name} {n}" for name, n in figures["threads"].items())
    table = Table(
        title=f"{figures['dataset']}, {width}x{height}: {figures['frames']} frames"
        + (f" in {figures['repeat']} rounds" if figures["repeat"] > 1 else ""),
        caption=f"the first {WARM_UP} frames of a round not counted, % of the median; threads: {threads}",
        title_justify="left",
    )
    table.add_column("time per frame, ms", no_wrap=True)
    for name in ("median", "p99", "max", "% of interval"):
        table.add_column(name, justify="right")
    for name, label in _NAMES.items():
        t = figures["us"][name]
        table.add_row(
            label, *(f"{t[k] / 1000.0:.2f}" for k in ("median", "p99", "max")), f"{100 * t['share_of_interval']:.1f}"
        )
    interval = f"{figures['interval_us'] / 1000.0:.2f}"
    table.add_row("real time: frame interval", interval, interval, interval, "100.0")
    return table


def _conclusions(figures: dict[str, Any]) -> Iterator[str]:
    us = figures["us"]
    yield f"tracked: {figures['tracked']} of {figures['frames']} frames"
    yield f"step : multi-mask detector = {figures['step_to_blobs']:.2f} : 1 (medians)"
    yield f"step : cv2.SimpleBlobDetector = {figures['step_to_SimpleBlobDetector']:.2f} : 1 (medians)"
    yield (
        f"faster than real time: {figures['times_faster_than_real_time']:.1f} times by the median, "
        f"{figures['interval_us'] / us[STEP]['p99']:.1f} by the 99th percentile, "
        f"{figures['interval_us'] / us[STEP]['max']:.1f} by the slowest frame"
    )
