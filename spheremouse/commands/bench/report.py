"""Summarise a measurement: figures for --json, a table, and notes below it."""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from spheremouse.commands.bench import (
    BLOBS,
    COMPARED,
    DETECT,
    FILTER,
    MEMORY_FROM,
    MIN_TRACKED,
    SIMPLE,
    STEP,
    WARM_UP,
)
from spheremouse.commands.bench.measure import Film, Steps, Times
from spheremouse.geometry.rotation import Array

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def report(
    film: Film,
    times: Times,
    repeat: int = 1,
    start: float = 0.0,
    row: Steps | None = None,
    sizes: dict[tuple[int, int], Steps] | None = None,
) -> dict[str, Any]:
    """Return the figures that --json writes: µs, bytes, and ratios of medians."""
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
        "sizes": {f"{w}x{h}": _steps(s) for (w, h), s in (sizes or {}).items()},
    }
    return {**figures, "ratios": _ratios(figures)}


def _summary(seconds: Array) -> dict[str, float]:
    return {
        "median": float(np.median(seconds)) * 1e6,
        "p99": float(np.quantile(seconds, 0.99)) * 1e6,
        "max": float(np.max(seconds)) * 1e6,
    }


def _steps(steps: Steps) -> dict[str, Any]:
    return {"steps": len(steps), "tracked": steps.tracked, "lost_episodes": steps.lost, "us": _summary(steps.seconds)}


def _steady(row: Steps) -> dict[str, Any]:
    us = _summary(row.seconds)
    return {
        **_steps(row),
        "processor_us": _summary(row.processor),
        "p99_to_median": us["p99"] / us["median"],
        "max_to_median": us["max"] / us["median"],
        "slowest_event": row.slowest,
        "memory_bytes": None if row.memory is None else {"early": row.memory[0], "end": row.memory[1]},
    }


def _ratios(figures: dict[str, Any]) -> dict[str, float]:
    """Return ratios of medians.

    They are each blob detector to the step, and the step of each larger picture to that of the smallest. For the steps
    in a row they are the 99th percentile and the slowest to the median.
    """
    ratios = {name: 1.0 / figures[f"step_to_{name}"] for name in (BLOBS, SIMPLE)}
    row = figures["steady"]
    if row is not None:
        ratios |= {"p99": row["p99_to_median"], "max": row["max_to_median"]}
    sizes = {name: steps["us"]["median"] for name, steps in figures["sizes"].items()}
    first = next(iter(sizes), "")
    return ratios | {name: median / sizes[first] for name, median in sizes.items() if name != first}


# ---- text ----

_NAMES = {
    STEP: "step: detect and filter",
    DETECT: "  its detect stage",
    FILTER: "  its filter stage",
    BLOBS: "multi-mask detector alone",
    SIMPLE: "cv2.SimpleBlobDetector alone",
}


def table(figures: dict[str, Any]) -> Table:
    """Return a table of times and ratios."""
    width, height = figures["size"]
    rows = Table(
        title=f"{figures['dataset']}, {width}x{height}, one thread; times in ms", title_justify="left", box=box.SIMPLE
    )
    rows.add_column("", no_wrap=True)
    for name in ("median", "p99", "worst", "ratio"):
        rows.add_column(name, justify="right", no_wrap=True)
    ratios = figures["ratios"]
    rounds = f", {figures['repeat']} rounds" if figures["repeat"] > 1 else ""
    rows.add_row(f"[bold]same {figures['frames']} frames, in turn{rounds}[/]")
    for name in COMPARED:
        rows.add_row(_NAMES[name], *_ms(figures["us"][name]), _ratio(ratios.get(name)))
    row = figures["steady"]
    if row is not None:
        rows.add_section()
        rows.add_row(f"[bold]{row['steps'] + WARM_UP:,} steps in a row[/]")
        rows.add_row("step", *_ms(row["us"]))
        rows.add_row("  its processor time", *_ms(row["processor_us"]))
        rows.add_row("  p99 over median", "", "", "", _ratio(ratios["p99"]))
        rows.add_row("  worst over median", "", "", "", _ratio(ratios["max"]))
        if row["memory_bytes"] is not None:
            grown = row["memory_bytes"]["end"] - row["memory_bytes"]["early"]
            rows.add_row(f"  memory after {MEMORY_FROM:,} steps", "", "", "", f"{grown / 2**20:+.1f} MB")
    if figures["sizes"]:
        rows.add_section()
        rows.add_row("[bold]far scene, in turn[/]")
        for name, steps in figures["sizes"].items():
            rows.add_row(name, *_ms(steps["us"]), _ratio(ratios.get(name)))
    return rows


def _ms(us: dict[str, float]) -> Iterator[str]:
    return (f"{us[name] / 1000.0:.2f}" for name in ("median", "p99", "max"))


def _ratio(ratio: float | None) -> str:
    if ratio is None:
        return ""
    return f"{ratio:.1f}×" if ratio >= 10.0 else f"{ratio:.2f}×"


def notes(figures: dict[str, Any]) -> Iterator[str]:
    """Yield the notes below the table."""
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
    if any(t < MIN_TRACKED * n for n, t in ran.values()):
        limit = f"{100 * MIN_TRACKED:.0f} % of the frames"
        yield f"warning: the ball was tracked in less than {limit}, so these times are not valid"
