"""Figures of a measurement, as --json writes them, and those that were asked for."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from spheremouse.commands.bench.measure import Film, Steps, Times
from spheremouse.commands.bench.series import BLOBS, MEMORY_STEPS, SIMPLE, SIZES, STEP, STEPS, TRACKED, WARM_UP
from spheremouse.geometry.rotation import Array

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
_FLAT = 1 << 20  # bytes: eleven a step would show


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
    tracked = figures["tracked"] >= TRACKED * figures["frames"]
    for name, least in ((BLOBS, 10.0), (SIMPLE, 12.0)):
        yield Target(name, 1.0 / figures[f"step_to_{name}"], least, None, ordinary and tracked)
    row = figures["steady"]
    if row is not None:
        enough = ordinary and row["steps"] + WARM_UP >= STEPS and _held(row)
        yield Target("p99", row["p99_to_median"], None, 2.5, enough)
        yield Target("max", row["max_to_median"], None, 8.0, enough)
        if row["memory_bytes"] is not None:
            grown = row["memory_bytes"]["end"] - row["memory_bytes"]["early"]
            yield Target("memory", grown, None, _FLAT, row["steps"] + WARM_UP >= MEMORY_STEPS and _held(row))
    sizes = figures["sizes"]
    if sizes:
        first, *others = (f"{w}x{h}" for w, h in SIZES)
        for name, most in zip(others, (1.5, 2.0), strict=True):
            ratio = sizes[name]["us"]["median"] / sizes[first]["us"]["median"]
            yield Target(name, ratio, None, most, _held(sizes[first]) and _held(sizes[name]))


def _held(steps: dict[str, Any]) -> bool:
    return bool(steps["tracked"] >= TRACKED * steps["steps"])
