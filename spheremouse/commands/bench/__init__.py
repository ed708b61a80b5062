"""`spheremouse bench`: measure the time per frame on this machine, on one thread."""

import json
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import JsonFile
from spheremouse.commands.terminal import progress_bar, table_console
from spheremouse.errors import ConfigurationError

WARM_UP = 10  # frames that do not count: caches, allocator and processor clock settle
_STEPS = 10_000  # in a row: a hundred of them are above the 99th percentile


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
    json_file: JsonFile = None,
) -> None:
    """Measure the time per frame on one thread: beside two blob detectors, and for many steps.

    The command finds the camera's pose before. Pose and the first 10 frames do not count; every other frame does. For
    another picture size, give a dataset that `simulate --size` made.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.bench import measure as benchmark
    from spheremouse.commands.bench.report import notes, report, table
    from spheremouse.files.safe_files import write_atomically

    check_outputs([json_file], [dataset], True)
    if 0 < steps <= WARM_UP:
        raise ConfigurationError(f"--steps: {steps}: the first {WARM_UP} do not count; give more, or 0")
    film = benchmark.simulated(frames) if dataset is None else benchmark.recorded(dataset, frames)
    with benchmark.one_thread(), progress_bar(auto_refresh=False) as bar:
        task = bar.add_task("starting", total=None)

        def progress(what: str, done: int, total: int) -> None:
            """Draw the bar between two measurements, a hundred times in all."""
            if done % max(1, total // 100) == 0:
                bar.update(task, description=what, completed=done, total=total, refresh=True)

        start = benchmark.start()
        times = benchmark.compare(film, repeat, progress)
        steady = benchmark.in_a_row(film, steps, progress) if steps else None
    figures = report(film, times, repeat, start, steady)
    text = json.dumps(figures, indent=1, allow_nan=False) + "\n"
    if json_file == Path("-"):
        typer.echo(text, nl=False)
        return
    console = table_console()
    console.print(table(figures))
    for line in notes(figures):
        console.print(line)
    if json_file is not None:
        write_atomically(json_file, text)
