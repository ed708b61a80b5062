"""Response of one output to the motion of the ball: frame and order of the axes, gain, dead zone and curve.

The motion is that of the pointer and the third axis, to which the settings `motion` or `wand.pointing` convert a
rotation or a shift. Every output has the options, and the trackers do not know of them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import degrees, hypot

from spheremouse.errors import OutputError
from spheremouse.files.registry import options

_BOUNDS = {"gain": (1e-3, 1e3), "full": (1.0, 10_000.0), "dead": (0.0, 0.9), "curve": (0.2, 5.0)}
_AXES = re.compile(r"(cam:)?((?:-?[xyz]|0){3})")


@dataclass(frozen=True, slots=True)
class Response:
    """Response of an output to motion."""

    gain: float = 1.0  # factor on the motion
    axes: str = "xyz"  # axes of the motion that become the output's x, y and third axis; `-` reverses one, 0 is none
    full: float = 180.0  # deg/s, at which the curve changes nothing; a hand rolls a ball at 60 to 170 deg/s in play
    dead: float = 0.0  # dead zone as a fraction of `full`
    curve: float = 1.0  # exponent; above 1, slow motion has less effect
    in_camera: bool = False  # the motion's directions are those of the camera's axes in place of obj's

    def factor(self, speed: float) -> float:
        """Return the factor on a motion at an angular speed, rad/s; 0 in the dead zone.

        Without a dead zone and a curve it is `gain`.
        """
        if self.dead == 0.0 and self.curve == 1.0:
            return self.gain
        fraction = degrees(speed) / self.full
        excess = (fraction - self.dead) / (1.0 - self.dead)
        return self.gain * excess**self.curve / fraction if excess > 0.0 else 0.0

    def deflection(self, rate: Sequence[float]) -> list[float]:
        """Return the deflection of a stick at a rate (n,) rad/s, with the same direction and length 0 to 1."""
        speed = hypot(*rate)
        size = min(1.0, self.factor(speed) * degrees(speed) / self.full)
        return [size * r / speed for r in rate] if size > 0.0 else [0.0] * len(rate)

    def to_axes(self, motion: Sequence[float]) -> list[float]:
        """Return the motion (3,) along the output's axes."""
        if self.axes == "xyz":
            return list(motion)
        x, y, z = motion
        return [a * x + b * y + c * z for a, b, c in _matrix(self.axes)]


KEYS: dict[str, type[float] | type[str]] = {"axes": str, **dict.fromkeys(_BOUNDS, float)}
COUNTS_RESPONSE = Response()  # of outputs that send counts: without loss
STICK_RESPONSE = Response(dead=0.02)  # of outputs that send rates: a ball at rest must not move a game


def split_response(spec: str) -> tuple[str, Response]:
    """Return `KIND:ARGUMENT` without options of the response, and the response; OutputError for an invalid value."""
    kind, _, argument = spec.partition(":")
    parts = argument.split(",")
    given = [part for part in parts if part.partition("=")[0].strip() in KEYS]
    if not given:
        return spec, COUNTS_RESPONSE
    rest = ",".join(part for part in parts if part not in given)
    return f"{kind}:{rest}" if rest else kind, parse_response(",".join(given), spec, COUNTS_RESPONSE)


def parse_response(text: str, spec: str, default: Response) -> Response:
    """Return the response that `KEY=VALUE,KEY=VALUE` describes. Raise OutputError with the output `spec` if invalid."""
    given = options(text, dict(KEYS), spec, OutputError)
    axes = str(given.pop("axes", default.axes))
    match = _AXES.fullmatch(axes)
    if match is None:
        problem = f"{spec}: axes must be three of x, y, z and 0, is {axes!r}"
        raise OutputError(problem, "write for example axes=x-yz, or axes=cam:xyz")
    for key, value in given.items():
        low, high = _BOUNDS[key]
        if not low <= float(value) <= high:
            raise OutputError(f"{spec}: {key} must be {low:g} to {high:g}, is {value:g}")
    return replace(default, axes=match[2], in_camera=match[1] is not None, **given)


@cache
def _matrix(axes: str) -> tuple[tuple[float, float, float], ...]:
    rows = []
    for sign, axis in re.findall("(-?)([xyz0])", axes):
        x, y, z = ((-1.0 if sign else 1.0) * (axis == name) for name in "xyz")
        rows.append((x, y, z))
    return tuple(rows)
