"""`spheremouse bench`: what a frame costs on this machine, beside what was asked for; measured in benchmark.py.

One thread: OpenCV is told so, and BLAS and Numba read their number of threads when they are imported, so that the
measurement runs in a process of its own that has it from the start.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from spheremouse.commands.bench import measure as benchmark
from spheremouse.commands.bench.measure import (
    BLOBS,
    COMPARED,
    DETECT,
    FILTER,
    MEMORY_FROM,
    SIMPLE,
    SIZES,
    STEP,
    WARM_UP,
    Film,
    Steps,
    Times,
)
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError
from spheremouse.files.atomic import write_atomically
from spheremouse.geometry.rotation import Array

_NAMES = {
    STEP: "step: detect and filter",
    DETECT: "  its detect stage",
    FILTER: "  its filter stage",
    BLOBS: "multi-mask detector alone",
    SIMPLE: "cv2.SimpleBlobDetector alone",
}
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
_STEPS = 10_000  # that p99 and worst are asked of
_MEMORY_STEPS = 100_000  # that flat memory is asked of
_FLAT = 1 << 20  # bytes: eleven a step would show
_WIDTH = 100  # characters that the table takes at most
_TRACKED = 0.95  # of the steps at least: one that does not track is quick


@dataclass(frozen=True, slots=True)
class Target:
    """A figure that was asked for."""

    what: str
    figure: float
    at_least: float | None
    at_most: float | None
    judged: bool  # measured as it was asked for: picture, number of steps, ball tracked

    @property
    def met(self) -> bool | None:
        """None: this run cannot say."""
        if not self.judged:
            return None
        return (self.at_least is None or self.figure >= self.at_least) and (
            self.at_most is None or self.figure <= self.at_most
        )


def bench(
    dataset: Annotated[
        Path | None,
        typer.Argument(metavar="DATASET", help="Folder.  [default: the simulated far scene]", show_default=False),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", min=WARM_UP + 1, help="Use the first N frames.")] = 300,
    repeat: Annotated[int, typer.Option(metavar="R", min=1, help="Compare on the frames R times.")] = 1,
    steps: Annotated[
        int, typer.Option(metavar="N", min=0, help="Then N steps in a row of the tracker alone; 0: none.")
    ] = _STEPS,
    no_sizes: Annotated[bool, typer.Option("--no-sizes", help="Leave the larger pictures out.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
) -> None:
    """Measure the time per frame on one thread: two blob detectors beside it, step after step, in larger pictures.

    The camera's pose is found first and not counted, nor are the first 10 frames; every other frame is.
    """
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
    console.print(_table(figures))
    for line in _notes(figures):
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


# ---- figures ----


def report(
    film: Film,
    times: Times,
    repeat: int = 1,
    start: float = 0.0,
    row: Steps | None = None,
    sizes: dict[tuple[int, int], Steps] | None = None,
) -> dict[str, Any]:
    """Figures that --json writes: µs, bytes, and ratios of medians."""
    us = {
        name: {**_summary(s), "share_of_interval": float(np.median(s)) / film.interval}
        for name, s in times.seconds.items()
    }
    step = us[STEP]["median"]
    figures = {
        "dataset": film.name,
        "size": [film.rig.camera.width, film.rig.camera.height],
        "frames": len(times),
        "repeat": repeat,
        "warm_up": WARM_UP,
        "tracked": times.tracked,
        "interval_us": film.interval * 1e6,
        "threads": {"OpenCV": "1", **{name: os.environ[name] for name in _THREADS if name in os.environ}},
        "start_us": start * 1e6,
        "us": us,
        "step_to_blobs": step / us[BLOBS]["median"],
        "step_to_SimpleBlobDetector": step / us[SIMPLE]["median"],
        "times_faster_than_real_time": film.interval * 1e6 / step,
        "steady": None if row is None else _steady(row),
        "sizes": {f"{w}x{h}": _in_short(s) for (w, h), s in (sizes or {}).items()},
    }
    figures["targets"] = [
        {"what": t.what, "figure": t.figure, "at_least": t.at_least, "at_most": t.at_most, "met": t.met}
        for t in targets(figures)
    ]
    return figures


def _summary(seconds: Array) -> dict[str, float]:
    return {
        "median": float(np.median(seconds)) * 1e6,
        "p99": float(np.quantile(seconds, 0.99)) * 1e6,
        "max": float(np.max(seconds)) * 1e6,
    }


def _in_short(steps: Steps) -> dict[str, Any]:
    return {"steps": len(steps), "tracked": steps.tracked, "lost_episodes": steps.lost, "us": _summary(steps.seconds)}


def _steady(row: Steps) -> dict[str, Any]:
    us = _summary(row.seconds)
    return {
        **_in_short(row),
        "processor_us": _summary(row.processor),
        "p99_to_median": us["p99"] / us["median"],
        "max_to_median": us["max"] / us["median"],
        "slowest_event": row.slowest,
        "memory_bytes": None if row.memory is None else {"early": row.memory[0], "end": row.memory[1]},
    }


def targets(figures: dict[str, Any]) -> Iterator[Target]:
    """Targets asked of this tracker, as far as they were measured; all in pictures of 640x480 but the last."""
    ordinary = tuple(figures["size"]) == SIZES[0]
    tracked = figures["tracked"] >= _TRACKED * figures["frames"]
    for name, least in ((BLOBS, 10.0), (SIMPLE, 12.0)):
        yield Target(name, 1.0 / figures[f"step_to_{name}"], least, None, ordinary and tracked)
    row = figures["steady"]
    if row is not None:
        enough = ordinary and row["steps"] + WARM_UP >= _STEPS and _held(row)
        yield Target("p99", row["p99_to_median"], None, 2.5, enough)
        yield Target("max", row["max_to_median"], None, 8.0, enough)
        if row["memory_bytes"] is not None:
            grown = row["memory_bytes"]["end"] - row["memory_bytes"]["early"]
            yield Target("memory", grown, None, _FLAT, row["steps"] + WARM_UP >= _MEMORY_STEPS and _held(row))
    sizes = figures["sizes"]
    if sizes:
        first, *others = (f"{w}x{h}" for w, h in SIZES)
        for name, most in zip(others, (1.5, 2.0), strict=True):
            ratio = sizes[name]["us"]["median"] / sizes[first]["us"]["median"]
            yield Target(name, ratio, None, most, _held(sizes[first]) and _held(sizes[name]))


def _held(steps: dict[str, Any]) -> bool:
    return bool(steps["tracked"] >= _TRACKED * steps["steps"])


# ---- as a table ----


def _table(figures: dict[str, Any]) -> Table:
    width, height = figures["size"]
    table = Table(
        title=f"{figures['dataset']}, {width}x{height}, one thread; times in ms", title_justify="left", box=box.SIMPLE
    )
    table.add_column("", no_wrap=True)
    for name in ("median", "p99", "worst", "ratio", "target", ""):
        table.add_column(name, justify="left" if name == "" else "right", no_wrap=True)
    asked = {t.what: t for t in targets(figures)}
    rounds = f", {figures['repeat']} rounds" if figures["repeat"] > 1 else ""
    table.add_row(f"[bold]same {figures['frames']} frames, in turn{rounds}[/]")
    for name in COMPARED:
        table.add_row(_NAMES[name], *_ms(figures["us"][name]), *_judged(asked.get(name), "×"))
    row = figures["steady"]
    if row is not None:
        table.add_section()
        table.add_row(f"[bold]{row['steps'] + WARM_UP:,} steps in a row[/]")
        table.add_row("step", *_ms(row["us"]))
        table.add_row("  its processor time", *_ms(row["processor_us"]))
        table.add_row("  p99 over median", "", "", "", *_judged(asked["p99"], "×"))
        table.add_row("  worst over median", "", "", "", *_judged(asked["max"], "×"))
        if "memory" in asked:
            table.add_row(f"  memory after {MEMORY_FROM:,} steps", "", "", "", *_judged(asked["memory"], "MB"))
    if figures["sizes"]:
        table.add_section()
        table.add_row("[bold]far scene, in turn[/]")
        for name, steps in figures["sizes"].items():
            table.add_row(name, *_ms(steps["us"]), *_judged(asked.get(name), "×"))
    return table


def _ms(us: dict[str, float]) -> Iterator[str]:
    return (f"{us[name] / 1000.0:.2f}" for name in ("median", "p99", "max"))


def _judged(target: Target | None, unit: str) -> tuple[str, str, str]:
    if target is None:
        return "", "", ""
    limit = f"≥ {target.at_least:g}×" if target.at_least is not None else f"≤ {target.at_most:g}×"
    figure = f"{target.figure:.1f}×" if target.figure >= 10.0 else f"{target.figure:.2f}×"
    if unit == "MB":
        figure, limit = f"{target.figure / 2**20:+.1f} MB", "≤ 1 MB"
    word = {True: "[green]met[/]", False: "[red]not met[/]", None: "[dim]not judged[/]"}[target.met]
    return figure, limit, word


def _notes(figures: dict[str, Any]) -> Iterator[str]:
    """Notes below the table."""
    us, row = figures["us"], figures["steady"]
    ran = {"compared": (figures["frames"], figures["tracked"])}
    many = ({"in a row": row} if row is not None else {}) | figures["sizes"]
    ran |= {name: (s["steps"], s["tracked"]) for name, s in many.items()}
    lost = sum(s["lost_episodes"] for s in many.values())
    yield "tracked: " + ", ".join(f"{t:,} of {n:,} {name}" for name, (n, t) in ran.items())
    if many:
        yield f"lost: {lost} times" if lost else "lost: never"
    if row is not None and row["slowest_event"]:
        yield f"the slowest step in a row: {row['slowest_event']}"
    yield f"start: {figures['start_us'] / 1e6:.2f} s for the compiled functions, before the first frame"
    yield (
        f"faster than real time: {figures['times_faster_than_real_time']:.1f} times by the median, "
        f"{figures['interval_us'] / us[STEP]['p99']:.1f} by the 99th percentile, "
        f"{figures['interval_us'] / us[STEP]['max']:.1f} by the slowest frame"
    )
    threads = ", ".join(f"{name} {n}" for name, n in figures["threads"].items())
    yield f"not counted: the first {WARM_UP} frames of each; ratios: of medians; threads: {threads}"
    why = []
    if tuple(figures["size"]) != SIZES[0]:
        why.append(f"pictures of {SIZES[0][0]}x{SIZES[0][1]}")
    if row is not None and row["steps"] + WARM_UP < _STEPS:
        why.append(f"--steps {_STEPS} for p99 and worst")
    if row is not None and row["memory_bytes"] is not None and row["steps"] + WARM_UP < _MEMORY_STEPS:
        why.append(f"--steps {_MEMORY_STEPS} for memory")
    if any(t < _TRACKED * n for n, t in ran.values()):
        why.append(f"a ball that is tracked in {100 * _TRACKED:.0f} % of the frames")
    if why:
        yield f"to be judged it takes {', '.join(why)}"
