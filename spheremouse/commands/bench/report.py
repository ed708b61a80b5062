"""Summarise a measurement: figures for --json, a table, and notes below it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from spheremouse.commands.bench import WARM_UP
from spheremouse.commands.bench.measure import BLOBS, DETECT, FILTER, MEMORY_FROM, SIMPLE, STEP, Film, Steps, Times
from spheremouse.geometry.rotation import Array

_MIN_TRACKED = 0.95  # of the steps; with fewer the times are not those of tracking
_NAMES = {
    STEP: "step: detect and filter",
    DETECT: "  its detect stage",
    FILTER: "  its filter stage",
    BLOBS: "multi-mask detector alone",
    SIMPLE: "cv2.SimpleBlobDetector alone",
}


def report(film: Film, times: Times, repeat: int = 1, start: float = 0.0, row: Steps | None = None) -> dict[str, Any]:
    """Return the figures that --json writes: µs, MB, and ratios of medians.

    A ratio compares a blob detector with the step, and the 99th percentile and the slowest of the steps in a row with
    their median.
    """
    us = {name: _summary(s) for name, s in times.seconds.items()}
    ratios = {name: us[name]["median"] / us[STEP]["median"] for name in (BLOBS, SIMPLE)}
    steady = None
    if row is not None:
        steady = {
            "steps": len(row),
            "tracked": row.tracked,
            "lost_episodes": row.lost,
            "us": _summary(row.seconds),
            "processor_us": _summary(row.processor),
            "slowest_event": row.slowest,
            "memory_grown_mb": row.grown_mb,
        }
        ratios |= {name: steady["us"][name] / steady["us"]["median"] for name in ("p99", "max")}
    return {
        "dataset": film.name,
        "size": [film.rig.camera.width, film.rig.camera.height],
        "frames": len(times),
        "repeat": repeat,
        "warm_up": WARM_UP,
        "tracked": times.tracked,
        "interval_us": film.interval * 1e6,
        "start_us": start * 1e6,
        "us": us,
        "steady": steady,
        "ratios": ratios,
    }


def _summary(seconds: Array) -> dict[str, float]:
    return {
        "median": float(np.median(seconds)) * 1e6,
        "p99": float(np.quantile(seconds, 0.99)) * 1e6,
        "max": float(np.max(seconds)) * 1e6,
    }


# ---- text ----


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
    for name, us in figures["us"].items():
        rows.add_row(_NAMES[name], *_ms(us), _ratio(ratios.get(name)))
    row = figures["steady"]
    if row is not None:
        rows.add_section()
        rows.add_row(f"[bold]{row['steps'] + WARM_UP:,} steps in a row[/]")
        rows.add_row("step", *_ms(row["us"]))
        rows.add_row("  its processor time", *_ms(row["processor_us"]))
        rows.add_row("  p99 over median", "", "", "", _ratio(ratios["p99"]))
        rows.add_row("  worst over median", "", "", "", _ratio(ratios["max"]))
        if row["memory_grown_mb"] is not None:
            rows.add_row(f"  memory after {MEMORY_FROM:,} steps", "", "", "", f"{row['memory_grown_mb']:+.1f} MB")
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
    ran |= {} if row is None else {"in a row": (row["steps"], row["tracked"])}
    yield "tracked: " + ", ".join(f"{t:,} of {n:,} {name}" for name, (n, t) in ran.items())
    if row is not None:
        yield f"lost: {row['lost_episodes']} times" if row["lost_episodes"] else "lost: never"
        if row["slowest_event"]:
            yield f"the slowest step in a row: {row['slowest_event']}"
    yield f"start: {figures['start_us'] / 1e6:.2f} s for the compiled functions, before the first frame"
    median, slow, worst = (figures["interval_us"] / us[STEP][name] for name in ("median", "p99", "max"))
    yield (
        f"faster than real time: {median:.1f} times by the median, {slow:.1f} by the 99th percentile, "
        f"{worst:.1f} by the slowest frame"
    )
    yield f"not counted: the first {WARM_UP} frames of each; ratios: of medians"
    if any(t < _MIN_TRACKED * n for n, t in ran.values()):
        limit = f"{100 * _MIN_TRACKED:.0f} % of the frames"
        yield f"warning: the ball was tracked in less than {limit}, so these times are not valid"
