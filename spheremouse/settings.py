"""How a parameter is declared: one line with its default, unit, meaning and bounds, read by whoever asks a person.

Settings are frozen dataclasses beside the code that uses them; `config` builds its schema from them, so that a
parameter is written down once. Every number has a bound on both sides, and every list a greatest length: what is
accepted must work, and beyond them nothing does that anybody could mean. The reason for a bound stands in the meaning
or in a comment beside it; those that many parameters share have theirs here.

What a film shows is declared so too, and `commands/options.py` makes the options of the command line from it.
"""

from dataclasses import field
from typing import Any, TypedDict


class Bounds(TypedDict, total=False):
    """Least and greatest value, themselves allowed (ge, le) or not (gt, lt)."""

    gt: float
    ge: float
    lt: float
    le: float


# How sure one may be of a place in a picture: a thousandth of a pixel is a tenth of what the best targets give, and
# what is known to 10 px only, a disc's size, is not known.
SIGMA_PX: Bounds = {"ge": 1e-3, "le": 10.0}
# A distance in a picture: below a hundredth of a pixel everything is noise, beyond 100 px it is another thing.
PIXELS: Bounds = {"ge": 0.01, "le": 100.0}
# An area in a picture: a tenth of a pixel, and a thousand pixels squared, which no disc has.
AREA: Bounds = {"ge": 0.1, "le": 1e6}
# A time that passes before something is done: a frame of the fastest camera, and an hour, when nobody waits any more.
SECONDS: Bounds = {"ge": 1e-3, "le": 3600.0}
# A part of something; below a thousandth nothing could have less.
SHARE: Bounds = {"ge": 1e-3, "le": 1.0}
# The same, where all of it is never reached.
PART: Bounds = {"ge": 1e-3, "lt": 1.0}
# Squared Mahalanobis distances, or standard deviations: a tenth keeps one true pair in twenty, a thousand any pair.
SIGMAS: Bounds = {"ge": 0.1, "le": 1e3}
# On an axis, besides the scale: a thousandth stands still, a thousand leaves the screen with one frame's jitter.
FACTOR: Bounds = {"ge": 1e-3, "le": 1e3}
# Counts per radian, or per metre: less than ten in a turn is none, and 10^6 leaves the screen with the least turn seen.
PER_RADIAN: Bounds = {"ge": 1.0, "le": 1e6}
# Of a hand, m/s and m/s²: a centimetre in a second rests, 100 is what a racket does.
HAND: Bounds = {"ge": 0.01, "le": 100.0}
# The same in rad/s and rad/s²: half a degree rests; at 1000 the ball goes round five times between two frames at 30 Hz.
HAND_TURN: Bounds = {"ge": 0.01, "le": 1000.0}
# An angle, rad: a hundredth of what a pixel resolves, and one beyond which nothing is known of a rotation.
ANGLE: Bounds = {"ge": 1e-4, "le": 1.0}
# Steps of a camera's controls: the kernel has them as signed numbers of 32 bits.
STEPS: Bounds = {"ge": 0, "le": 2**31 - 1}
# Widths of filters on pictures: OpenCV's median goes to 31, and no filter of noise wants more.
WIDTH: Bounds = {"ge": 1, "le": 31}
# Frames that something is counted in: a second of the fastest camera.
FRAMES: Bounds = {"ge": 1, "le": 1000}


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
    """A dataclass field with its unit ("-" for none), its meaning with the reason for the default, and its bounds.

    `most` bounds the length of a list. `refused` is the remedy for a rejected value. `null` is the value that a written
    `null` means, if that differs from leaving the key out. `pair` is a sign between two numbers: with "x", 640x480 is
    [640, 480]. A class names its former settings in `GONE`, each with its replacement.
    """
    bounds = {k: v for k, v in {"gt": gt, "ge": ge, "lt": lt, "le": le}.items() if v is not None}
    metadata = {"unit": unit, "meaning": meaning, "bounds": bounds, "most": most, "refused": refused}
    metadata |= {"null": null, "pair": pair}
    return field(default=default, metadata=metadata)
