"""What sending costs, in figures and in words."""

import math
from typing import Any

import numpy as np
import typer

from spheremouse.output.serial.benchmark import Measured

_INTERVAL = 4e-3  # s, of a camera with 250 frames a second
_SHARE = 0.05  # of it, that sending may add


def figures(m: Measured, damage: float, baud: int | None) -> dict[str, Any]:
    """Figures that --json writes; `damage` is a share."""
    return {
        "rate": m.rate,
        "motions": len(m.call),
        "reports": m.reports,
        "exact": m.exact,
        "damage": damage,
        "baud": baud,
        "call_us": _quantiles(m.call),
        "latency_us": _quantiles(m.latency),
        "round_trip_us": {"median": _us(m.line.round_trip[0]), "p99": _us(m.line.round_trip[1])},
        "call_share_of_250_Hz": float(np.median(m.call)) / _INTERVAL,
        "latency_share_of_250_Hz": float(np.median(m.latency)) / _INTERVAL if len(m.latency) else None,
    }


def print_figures(figures: dict[str, Any]) -> None:
    """The same for people."""
    exact = "exact" if figures["exact"] else "OFF"
    typer.echo(
        f"{figures['motions']} motions at {figures['rate']:.1f}/s, {figures['reports']} reports; the sum is {exact}"
    )
    for name, key in (("in send()", "call_us"), ("to the board's report", "latency_us")):
        q = figures[key]
        if q is None:
            typer.echo(f"{name:22} none arrived")
        else:
            typer.echo(f"{name:22} median {q['median']:.0f} µs, 99 % {q['p99']:.0f} µs, worst {q['max']:.0f} µs")
    if (share := figures["latency_share_of_250_Hz"]) is not None:
        typer.echo(f"median latency {100 * share:.1f} % of a 250 Hz interval (asked for: {100 * _SHARE:.0f} % at most)")


def _us(seconds: float) -> float | None:
    """As JSON can hold it."""
    return None if math.isnan(seconds) else 1e6 * seconds


def _quantiles(seconds: Any) -> dict[str, float] | None:
    if not len(seconds):
        return None
    return {
        "median": 1e6 * float(np.median(seconds)),
        "p99": 1e6 * float(np.quantile(seconds, 0.99)),
        "max": 1e6 * float(np.max(seconds)),
    }
