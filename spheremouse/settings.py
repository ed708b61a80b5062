"""Declare a setting by one call of `param`: default, unit, meaning and bounds.

Settings are frozen dataclasses beside the code that uses them. Schema, configuration file and pages are made from them.
A field without `param` is a constant that code may replace. A configuration file that sets it gets an error.
Every number has two bounds and every list a maximum length; every accepted value works. The reason for a bound is in
the meaning or in a comment. Bounds that several settings share are here.

`commands/options.py` makes options of the command line from the settings of a simulated film in the same way.
"""

from dataclasses import field
from typing import Any, TypedDict, Unpack


class Bounds(TypedDict, total=False):
    """Bounds of a number that include (ge, le) or exclude (gt, lt) their value, and the maximum length of a list."""

    gt: float
    ge: float
    lt: float
    le: float
    most: int


# An area in an image; no disc has 1000 x 1000 px.
AREA: Bounds = {"ge": 0.1, "le": 1e6}
# A waiting time: from a frame of the fastest camera to an hour.
SECONDS: Bounds = {"ge": 1e-3, "le": 3600.0}
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
    refused: str = "",
    null: str | None = None,
    pair: str = "",
    **bounds: Unpack[Bounds],
) -> Any:
    """Return a dataclass field with unit ("-" for none), meaning with the reason for the default, and bounds.

    `refused` is the remedy for a rejected value. `null` is the value that a written `null` means, if that differs from
    leaving the key out. `pair` is a sign between two numbers: with "x", 640x480 is [640, 480].
    """
    most = bounds.pop("most", None)
    metadata = {"unit": unit, "meaning": meaning, "bounds": bounds, "most": most, "refused": refused}
    return field(default=default, metadata={**metadata, "null": null, "pair": pair})


def option_name(field: str) -> str:
    """Return the command-line option of a field."""
    return "--" + field.replace("_", "-")
