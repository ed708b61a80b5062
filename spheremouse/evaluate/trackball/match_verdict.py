"""What a match means: in words, and as settings with which the pointer moves as the trackball moved it."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from spheremouse.evaluate.trackball.match import Match
from spheremouse.output.counts import MotionSettings, Player

_CHANCE = 40.0  # logarithm of a likelihood ratio: logs of other simulated plays reached 14 at their best lag
_RIVAL = 0.8  # of the best lag's: a second one that good may be the right one
_GOOD, _FAIR, _UNLIKE = 0.95, 0.8, 0.5  # correlation over 0.1 s
_OTHER_CLOCK = 0.5  # s; no mouse is that late
_DRIFTS = 5e-5  # quartz keeps time to some parts in 100,000
_TURNED = np.radians(3.0)
_TILTED = np.radians(10.0)
_CUT = 0.05  # share of intervals
_FEW = 100.0  # counts

_MOVE = ("roll the ball towards you and away", "spin it about the vertical", "roll it left and right")


class Kind(StrEnum):
    """Outcomes of a match."""

    AGREES = "agrees"
    ROUGHLY = "agrees roughly"
    TOO_LITTLE = "too little motion"
    DIFFERS = "does not agree"
    ANOTHER_TIME = "another time"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome of a match, and its reasons in words."""

    kind: Kind
    text: str  # one sentence
    notes: tuple[str, ...]  # further ones

    @property
    def usable(self) -> bool:
        """Scale and axes may be used."""
        return self.kind in (Kind.AGREES, Kind.ROUGHLY)


def judge(found: Match) -> Verdict:
    """The verdict on a match."""
    kind, text = _kind(found)
    notes = list(_of_time(found)) if kind is not Kind.ANOTHER_TIME else []
    if kind in (Kind.AGREES, Kind.ROUGHLY):
        notes += _of_axes(found)
    if kind is not Kind.ANOTHER_TIME and found.cut > _CUT * found.intervals:
        notes.append(
            f"{found.cut} of {found.intervals} intervals of 0.1 s were left out: there reports are missing, or the "
            "trackball slips"
        )
    return Verdict(kind, text, tuple(notes))


def _kind(found: Match) -> tuple[Kind, str]:
    r, rival = found.r_interval, found.peak.second > _RIVAL * found.peak.likelihood
    if r < _UNLIKE or found.peak.likelihood < _CHANCE or (rival and abs(found.lag) > _OTHER_CLOCK):
        return Kind.ANOTHER_TIME, (
            "no lag stands out at which the log follows the ball: it is of another time or another mouse, or the two "
            "have too little in common; record both at once, for half a minute"
        )
    missing = [k for k in (0, 2) if not found.known[k]]
    if missing:
        return Kind.TOO_LITTLE, (
            f"too little motion about {' and '.join('XYZ'[k] for k in missing)} to know the scale: "
            f"{' and '.join(_MOVE[k] for k in missing)}, and record again"
        )
    for axis, counts in zip("xy", found.sums, strict=True):
        if counts < _FEW:
            return Kind.TOO_LITTLE, (
                f"the trackball's {axis} hardly moved ({counts:.0f} counts in all) while the ball did: one of its "
                "sensors is dirty or dead, or it does not touch the ball"
            )
    if r >= _GOOD:
        return Kind.AGREES, f"the two agree (r = {r:.4f} over 0.1 s)"
    if r >= _FAIR:
        return Kind.ROUGHLY, (
            f"the two agree roughly (r = {r:.3f} over 0.1 s): the trackball slips or loses reports, or the ball was "
            "badly tracked; the scale is good to its standard deviation all the same"
        )
    return Kind.DIFFERS, f"the log follows the ball, but badly (r = {r:.2f} over 0.1 s): no scale is taken from it"


def _of_time(found: Match) -> list[str]:
    notes = []
    if abs(found.lag) > _OTHER_CLOCK:
        notes.append(
            f"the log's clock is not that of the frames: it is {abs(found.lag):.3f} s "
            f"{'ahead' if found.lag > 0 else 'behind'}; that does no harm here"
        )
    if abs(found.drift) > max(_DRIFTS, 3.0 * found.drift_sigma):
        notes.append(
            f"the log's clock is {'faster' if found.drift > 0 else 'slower'} by {1e6 * abs(found.drift):.0f} "
            f"± {1e6 * found.drift_sigma:.0f} millionths than that of the frames"
        )
    if found.peak.second > _RIVAL * found.peak.likelihood:
        notes.append("the motion repeats itself, so that another lag explains the log nearly as well; move less evenly")
    return notes


# ---- axes ----


@dataclass(frozen=True, slots=True)
class Axes:
    """Directions of the trackball's axes, as far as settings can say them, and what is left over."""

    swapped: bool
    scale: tuple[float, float]  # counts/rad of x and y, with their signs
    sigma: tuple[float, float]  # counts/rad
    turned: float  # rad, right-handed about Y, beyond what swap and signs say
    turned_sigma: float  # rad
    below: tuple[float, float, float] | None  # unit vector in obj to where it touches the ball; None: not known


def axes_of(found: Match) -> Axes:
    """The axes of a match."""
    A, S = found.matrix, found.sigma
    straight, crossed = A[0, 2] ** 2 + A[1, 0] ** 2, A[0, 0] ** 2 + A[1, 2] ** 2
    swapped = bool(crossed > straight)
    x, y = (0, 2) if swapped else (2, 0)
    on = np.array([A[0, x], A[1, y]])
    off = np.array([A[0, y], A[1, x]])
    sigma = np.array([S[0, x], S[1, y]])
    size = np.hypot(on, off) * np.sign(on)
    mean, apart = np.sum(on / size), off[0] / size[0] - off[1] / size[1]
    turned = float(np.arctan2(-apart if swapped else apart, mean))
    spread = np.array([S[0, y], S[1, x]]) / size
    below = None
    if bool(np.all(found.known)):
        normal = np.cross(A[0], A[1])
        normal *= -np.sign(normal[1]) / np.linalg.norm(normal)
        below = (float(normal[0]), float(normal[1]), float(normal[2]))
    return Axes(
        swapped,
        (float(on[0]), float(on[1])),
        (float(sigma[0]), float(sigma[1])),
        turned,
        float(0.5 * np.hypot(*spread)),
        below,
    )


def _of_axes(found: Match) -> list[str]:
    axes = axes_of(found)
    notes = []
    if axes.swapped:
        notes.append("its x went with the ball rolling towards the camera and away: it is turned by 90°")
    if _seat(axes)[1]:
        notes.append("its axes are those of a mirror image: no player's hand goes that way; y is reversed")
    if not found.known[1]:
        notes.append("the ball hardly spun about Y: what a spin does to the trackball is not known, and not needed")
    if abs(axes.turned) > max(_TURNED, 3.0 * axes.turned_sigma):
        notes.append(
            f"its axes are turned by {np.degrees(axes.turned):+.1f} ± {np.degrees(axes.turned_sigma):.1f}° about Y "
            "against X and Z of obj, which no setting says: the pointer will go off by that angle"
        )
    if axes.below is not None:
        tilt = float(np.arccos(np.clip(-axes.below[1], -1.0, 1.0)))
        if tilt > _TILTED:
            notes.append(
                f"it touches the ball {np.degrees(tilt):.0f}° from the lowest point (towards X {axes.below[0]:+.2f}, "
                f"Z {axes.below[2]:+.2f} of obj): a spin of the ball moved it too, and will not move the pointer"
            )
    return notes


def settings_of(found: Match, radius: float | None, before: MotionSettings) -> MotionSettings:
    """Settings with which the pointer's x and y move as the trackball moved them; the third axis stays as it was.

    `radius` of the ball in m, None where it is not known in metres: then the scale is per radian. One scale for both
    axes where they do not differ by more than twice their standard deviation.
    """
    axes = axes_of(found)
    x, y = abs(axes.scale[0]), abs(axes.scale[1])
    weight = np.array(axes.sigma) ** -2.0
    both = float(weight @ (x, y) / weight.sum())
    if abs(x - y) <= 2.0 * float(np.hypot(*axes.sigma)):
        x = y = both
    base = float(np.sqrt(x * y))
    per_radian = radius is None
    rounded = _rounded(base if radius is None else base / (1000.0 * radius))
    real = rounded if radius is None else 1000.0 * radius * rounded
    third = before.scale_z * before.scale(radius) / real
    player, mirrored = _seat(axes)
    return replace(
        before,
        player=player,
        counts_per_mm=before.counts_per_mm if per_radian else rounded,
        counts_per_radian=rounded if per_radian else None,
        scale_x=1.0 if x == y else _rounded(x / real),
        scale_y=1.0 if x == y else _rounded(y / real),
        scale_z=_rounded(third),
        invert_x=False,
        invert_y=mirrored,
    )


def _seat(axes: Axes) -> tuple[Player, bool]:
    """Where a player stands whose hand the trackball's x follows, and whether its y is reversed to them."""
    seats: tuple[Player, Player] = ("left", "right") if axes.swapped else ("far-side", "camera-side")
    player = seats[axes.scale[0] < 0.0]
    y = MotionSettings(player=player).directions()[1]
    return player, bool(axes.scale[1] * y[2 if axes.swapped else 0] < 0.0)


def _rounded(value: float) -> float:
    """To five digits: a hundredth of a per cent is more than a hand feels."""
    return float(f"{value:.5g}")
