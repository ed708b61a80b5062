"""The columns of a table of samples, one row a ball and frame, for the outputs `csv`, `parquet` and `lsl`.

A table of a hand-held ball also has position and velocity. Values that are unknown are None: attitude, motion and their
covariances unless the ball is tracked, and wall clock and latency unless a service or --realtime made them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.output.sample import Sample, StillAxes, to_quaternion
from spheremouse.tracker import Status


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table."""

    name: str
    type: type[float] | type[int] | type[bool] | type[str]
    unit: str = ""  # empty: a number, or a text
    frame: str = ""  # axes of a vector's component; `obj from ball`: a rotation to obj
    meaning: str = ""


def columns(coordinates: StillAxes) -> tuple[Column, ...]:
    """Return the columns for samples in these axes."""
    held = coordinates == "cam"
    return (
        Column("stamp", float, "s", meaning="mid-exposure, on the clock of the source"),
        Column("wall", float, "s", meaning="mid-exposure, since 1970 (UTC)"),
        Column("sequence", int, meaning="frames since the tracker began"),
        Column("ball", int, meaning="number of the ball, from 1"),
        Column("status", str, meaning="searching, tracking or lost"),
        Column("confirmed", bool, meaning="this frame supports the estimate; otherwise it is a prediction"),
        *_vector("quaternion", "wxyz", "", f"{coordinates} from ball", "attitude, a unit quaternion"),
        *_vector("rate", "xyz", "rad/s", coordinates, "angular velocity"),
        *_vector("increment", "xyz", "rad", coordinates, "rotation vector since the last confirmed estimate"),
        *_covariance("attitude_covariance", "rad2", coordinates, "of the attitude error e, exp(e) R"),
        *_covariance("rate_covariance", "rad2/s2", coordinates, "of the angular velocity"),
        *(_vector("position", "xyz", "m", coordinates, "position of the centre") if held else ()),
        *(_vector("velocity", "xyz", "m/s", coordinates, "velocity of the centre") if held else ()),
        *(_covariance("position_covariance", "m2", coordinates, "of the position") if held else ()),
        *(Column(f"count_{axis}", int, "counts", meaning=f"counts of the mouse, {axis}") for axis in "xyz"),
        *(() if held else _STATISTICS),
        Column("latency", float, "s", meaning="from the exposure to publication"),
        Column("events", str, meaning="changes with this frame, separated by spaces"),
    )


def rows(report: Report) -> Iterator[list[Any]]:
    """Yield the row of each sample of a report, in the order of `columns`; only the ball that points has counts."""
    for sample, counts in report.counted:
        e = sample.estimate
        hand_held, tracked, rate = sample.coordinates == "cam", e.status is Status.TRACKING, e.rate.tolist()
        numbers = [
            *to_quaternion(e.rotation),
            *rate[:3],
            *e.increment.tolist()[:3],
            *_upper(sample.attitude_covariance),
            *_upper(sample.rate_covariance),
        ]
        if hand_held:
            numbers += [*e.position.tolist(), *rate[3:], *_upper(sample.position_covariance)]
        yield [
            float(e.stamp),
            sample.wall,
            int(e.sequence),
            sample.ball,
            str(e.status),
            bool(e.confirmed),
            *(v if tracked and isfinite(v) else None for v in numbers),
            *counts,
            *(() if hand_held else _statistics(sample)),
            sample.latency,
            " ".join(sample.events),
        ]


_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
_STATISTICS = (
    Column("discs_used", float, meaning="discs, or parts of a pattern, that corrected the estimate"),
    Column("discs_seen", float, meaning="points of the picture that may be such"),
    Column("discs_known", float, meaning="such in the map"),
    Column("nis", float, meaning="normalised innovation squared, chi-square with 2 degrees of freedom a point used"),
)


def _vector(name: str, axes: str, unit: str, frame: str, meaning: str) -> list[Column]:
    return [Column(f"{name}_{axis}", float, unit, frame, f"{meaning}, {axis}") for axis in axes]


def _covariance(name: str, unit: str, frame: str, meaning: str) -> list[Column]:
    return [Column(f"{name}_{pair}", float, unit, frame, f"covariance {meaning}, {pair}") for pair in _PAIRS]


def _upper(covariance: Array) -> tuple[float, ...]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = covariance.tolist()
    return xx, xy, xz, yy, yz, zz


def _statistics(sample: Sample) -> list[float | None]:
    found = sample.estimate.statistics
    return [float(v) if (v := found.get(c.name)) is not None and isfinite(v) else None for c in _STATISTICS]
