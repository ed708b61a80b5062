"""`spheremouse bench`: what a frame costs on this machine; measured in measure.py.

One thread: OpenCV is told so, and BLAS and Numba read their number of threads when they are imported, so that the
measurement runs in a process of its own that has it from the start.
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

from spheremouse.commands.bench.series import STEPS, WARM_UP
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
_WIDTH = 100  # characters that the table takes at most


def bench(
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="DATASET", help="Folder.  [default: the simulated far scene]", show_default=False),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", min=WARM_UP + 1, help="Use the first N frames.")] = 300,
    repeat: Annotated[int, typer.Option(metavar="R", min=1, help="Compare on the frames R times.")] = 1,
    steps: Annotated[
        int, typer.Option(metavar="N", min=0, help="Then N steps in a row of the tracker alone; 0: none.")
    ] = STEPS,
    no_sizes: Annotated[bool, typer.Option("--no-sizes", help="Leave the larger pictures out.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
) -> None:
    """Measure the time per frame on one thread: two blob detectors beside it, step after step, in larger pictures.

    The camera's pose is found first and not counted, nor are the first 10 frames; every other frame is.
    """
    from rich.console import Console

    from spheremouse.commands.bench import measure as benchmark
    from spheremouse.commands.bench.figures import report
    from spheremouse.commands.bench.table import notes, table
    from spheremouse.files.safe_files import write_atomically

    if json_file is not None and not json_file.parent.is_dir():
        raise ConfigurationError(f"--json: {json_file.parent}: no such folder")
    if 0 < steps <= WARM_UP:
        raise ConfigurationError(f"--steps: {steps}: the first {WARM_UP} do not count; more than that, or 0")
    if any(name not in os.environ for name in _ONE_THREAD):
        command = [sys.executable, "-m", "spheremouse", *sys.argv[1:]]
        child = subprocess.run(command, env={**_ONE_THREAD, **os.environ}, check=False)
        raise typer.Exit(child.returncode if child.returncode >= 0 else 128 - child.returncode)
    film = benchmark.simulated(frames) if dataset is None else benchmark.recorded(dataset, frames)
    with benchmark.one_thread(), Bar() as bar:
        start = benchmark.start()
        times = benchmark.compare(film, repeat, bar.progress)
        row = benchmark.in_a_row(film, steps, bar.progress) if steps else None
        sizes = {} if no_sizes else benchmark.by_size(progress=bar.progress)
    figures = report(film, times, repeat, start, row, sizes)
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    console = Console(soft_wrap=True)
    console.width = max(console.width, _WIDTH)
    console.print(table(figures))
    for line in notes(figures):
        console.print(line, highlight=False)
    if json_file is not None:
        write_atomically(json_file, text)


class Bar:
    """Progress on a terminal; a context manager. Drawn between two measurements, not beside them."""

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
        """So much is done; drawn when it is time."""
        now = time.perf_counter()
        if self._bars.disable or (now < self._due and 0 < done < total):
            return
        self._due = now + 0.5
        self._bars.update(self._task, description=what, completed=done, total=total, refresh=True)
