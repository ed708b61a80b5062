"""Figures of a measurement, as --json writes them."""

import os
from typing import Any

import numpy as np

from spheremouse.commands.bench.measure import Film, Steps, Times
from spheremouse.commands.bench.series import BLOBS, SIMPLE, STEP, WARM_UP
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
    return {**figures, "ratios": _ratios(figures)}


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


def _ratios(figures: dict[str, Any]) -> dict[str, float]:
    """Ratios of medians: each blob detector over the step, the step of each larger picture over that of the smallest;
    and of the steps in a row the 99th percentile and the slowest over the median."""
    ratios = {name: 1.0 / figures[f"step_to_{name}"] for name in (BLOBS, SIMPLE)}
    row = figures["steady"]
    if row is not None:
        ratios |= {"p99": row["p99_to_median"], "max": row["max_to_median"]}
    sizes = {name: steps["us"]["median"] for name, steps in figures["sizes"].items()}
    first = next(iter(sizes), "")
    return ratios | {name: median / sizes[first] for name, median in sizes.items() if name != first}
