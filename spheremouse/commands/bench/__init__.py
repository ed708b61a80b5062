"""`spheremouse bench`: measure the time per frame on this machine.

The measurement runs on one thread. BLAS and Numba read their number of threads when they are imported, so it runs in a
process of its own that has the number from the start.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

import typer

from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError

WARM_UP = 10  # frames that do not count: caches, allocator and processor clock settle
BLOCK = 30  # frames that one of the compared processes before the next: a second of video
STEP, DETECT, FILTER, BLOBS, SIMPLE = "step", "detect", "filter", "blobs", "SimpleBlobDetector"
COMPARED = (STEP, DETECT, FILTER, BLOBS, SIMPLE)
SIZES = ((640, 480), (1280, 720), (1920, 1080))  # px; the others are compared with the first
MEMORY_FROM = 1000  # steps, until the allocator has what it needs
MIN_TRACKED = 0.95  # of the steps; with fewer the times are not those of tracking
_STEPS = 10_000  # in a row: a hundred of them are above the 99th percentile
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
_TABLE_WIDTH = 100  # characters


def bench(
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="DATASET", help="Folder.  [default: the simulated far scene]", show_default=False),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", min=WARM_UP + 1, help="Use the first N frames.")] = 300,
    repeat: Annotated[int, typer.Option(metavar="R", min=1, help="Compare on the frames R times.")] = 1,
    steps: Annotated[
        int, typer.Option(metavar="N", min=0, help="Then run the tracker alone for N steps in a row. 0: none.")
    ] = _STEPS,
    no_sizes: Annotated[bool, typer.Option("--no-sizes", help="Do not measure larger pictures.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
) -> None:
    """Measure the time per frame on one thread: beside two blob detectors, for many steps, and in larger pictures.

    The command finds the camera's pose before. Pose and the first 10 frames do not count; every other frame does.
    """
    from rich.console import Console

    from spheremouse.commands.bench import measure as benchmark
    from spheremouse.commands.bench.report import notes, report, table
    from spheremouse.files.safe_files import write_atomically

    if json_file is not None and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    if 0 < steps <= WARM_UP:
        raise ConfigurationError(f"--steps: {steps}: the first {WARM_UP} do not count; give more, or 0")
    if any(name not in os.environ for name in _ONE_THREAD):
        command = [sys.executable, "-m", "spheremouse", *sys.argv[1:]]
        child = subprocess.run(command, env={**_ONE_THREAD, **os.environ}, check=False)
        raise typer.Exit(child.returncode if child.returncode >= 0 else 128 - child.returncode)
    film = benchmark.simulated(frames) if dataset is None else benchmark.recorded(dataset, frames)
    with benchmark.one_thread(), Bar() as bar:
        start = benchmark.start()
        times = benchmark.compare(film, repeat, bar.progress)
        steady = benchmark.in_a_row(film, steps, bar.progress) if steps else None
        sizes = {} if no_sizes else benchmark.by_size(progress=bar.progress)
    figures = report(film, times, repeat, start, steady, sizes)
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    console = Console(soft_wrap=True)
    console.width = max(console.width, _TABLE_WIDTH)
    console.print(table(figures))
    for line in notes(figures):
        console.print(line, highlight=False)
    if json_file is not None:
        write_atomically(json_file, text)


class Bar:
    """Shows progress on a terminal, between two measurements and never during one."""

    def __init__(self) -> None:
        self._bars = progress_bar(auto_refresh=False)
        self._task = self._bars.add_task("starting", total=None)
        self._due = 0.0

    def __enter__(self) -> Self:
        self._bars.start()
        self._bars.refresh()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def progress(self, what: str, done: int, total: int) -> None:
        """Update the bar, at most twice a second."""
        now = time.perf_counter()
        if self._bars.disable or (now < self._due and 0 < done < total):
            return
        self._due = now + 0.5
        self._bars.update(self._task, description=what, completed=done, total=total, refresh=True)
