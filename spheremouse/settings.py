"""Declare a setting by one call of `param`: default, unit, meaning and bounds.

Settings are frozen dataclasses beside the code that uses them. Schema, configuration file and pages are made from them.
A field without `param` is a constant that code may replace; no configuration file can set it.
Every number has two bounds and every list a maximum length; every accepted value works. The reason for a bound is in
the meaning or in a comment. Bounds that several settings share are here.

`commands/options.py` makes options of the command line from the settings of a simulated film in the same way.
"""

from dataclasses import field
from typing import Any, TypedDict


class Bounds(TypedDict, total=False):
    """Bounds that include (ge, le) or exclude (gt, lt) their value."""

    gt: float
    ge: float
    lt: float
    le: float


# Standard deviation of a position in an image: the best targets reach 0.01 px, and 10 px is the size of a disc.
SIGMA_PX: Bounds = {"ge": 1e-3, "le": 10.0}
# An area in an image; no disc has 1000 x 1000 px.
AREA: Bounds = {"ge": 0.1, "le": 1e6}
# A waiting time: from a frame of the fastest camera to an hour.
SECONDS: Bounds = {"ge": 1e-3, "le": 3600.0}
# A fraction.
SHARE: Bounds = {"ge": 1e-3, "le": 1.0}
# A fraction below 1.
PART: Bounds = {"ge": 1e-3, "lt": 1.0}
# Squared Mahalanobis distances, or standard deviations: 0.1 keeps one true pair in twenty, 1000 any pair.
SIGMAS: Bounds = {"ge": 0.1, "le": 1e3}
# A factor on an axis: with 0.001 the pointer stands still, with 1000 the noise of a frame leaves the screen.
FACTOR: Bounds = {"ge": 1e-3, "le": 1e3}
# Counts per radian, or per metre: 1 gives six counts in a turn, with 10^6 the noise leaves the screen.
PER_RADIAN: Bounds = {"ge": 1.0, "le": 1e6}
# Motion of a hand, m/s and m/s²: 0.01 is rest, 100 a racket.
HAND: Bounds = {"ge": 0.01, "le": 100.0}
# Rotation of a hand, rad/s and rad/s²: 0.01 is rest, 1000 five turns between two frames at 30 Hz.
HAND_TURN: Bounds = {"ge": 0.01, "le": 1000.0}
# Steps of a camera's controls, in the kernel 32-bit integers.
STEPS: Bounds = {"ge": 0, "le": 2**31 - 1}


def param(
    default: Any,
    unit: str,
    meaning: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    most: int | None = None,
    refused: str = "",
    null: str | None = None,
    pair: str = "",
) -> Any:
    """Return a dataclass field with unit ("-" for none), meaning with the reason for the default, and bounds.

    `most` bounds the length of a list. `refused` is the remedy for a rejected value. `null` is the value that a written
    `null` means, if that differs from leaving the key out. `pair` is a sign between two numbers: with "x", 640x480 is
    [640, 480]. A class names its former settings in `GONE`, each with its replacement.
    """
    bounds = {k: v for k, v in {"gt": gt, "ge": ge, "lt": lt, "le": le}.items() if v is not None}
    metadata = {"unit": unit, "meaning": meaning, "bounds": bounds, "most": most, "refused": refused}
    metadata |= {"null": null, "pair": pair}
    return field(default=default, metadata=metadata)
