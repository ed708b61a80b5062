"""Judge a match of trackball and ball, and turn it into settings that move the pointer as the trackball did."""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.evaluate.trackball import Match
from spheremouse.output.counts import MotionSettings, Player

_MIN_LIKELIHOOD = 40.0  # logarithm; logs of other simulated plays reached 20 at their best lag
_RIVAL_RATIO = 0.8  # a second lag with so much of the best likelihood may be the right one
_MIN_GOOD_R, _MIN_FAIR_R, _MIN_RELATED_R = 0.95, 0.8, 0.5
_MAX_LAG_OF_A_MOUSE_S = 0.5
_MAX_OUTLIERS = 0.05  # of the intervals
_MIN_COUNTS = 100.0
_MIN_TURN = np.radians(3.0)
_MIN_TILT = np.radians(10.0)
_ADVICE = ("roll the ball towards you and away", "spin it about the vertical", "roll it left and right")


@dataclass(frozen=True, slots=True)
class Verdict:
    """The assessment of a match for a person."""

    usable: bool  # scale and axes
    text: str  # one sentence
    notes: tuple[str, ...] = ()


def judge(match: Match) -> Verdict:
    """Return the verdict on a match: unusable with the reason, or usable with notes."""
    problem = _problem(match)
    if problem is not None:
        return Verdict(False, problem)
    r = match.r_pooled
    text = f"the two agree (r = {r:.4f} over 0.1 s)"
    if r < _MIN_GOOD_R:
        text = (
            f"the two agree roughly (r = {r:.3f} over 0.1 s): the trackball slips or loses reports, or the camera "
            "tracked the ball badly; the standard deviations of the scale are valid all the same"
        )
    return Verdict(True, text, (*_time_notes(match), *_axis_notes(match)))


def _problem(match: Match) -> str | None:
    r, peak = match.r_pooled, match.peak
    repeats = peak.rival > _RIVAL_RATIO * peak.likelihood and abs(match.lag) > _MAX_LAG_OF_A_MOUSE_S
    if r < _MIN_RELATED_R or peak.likelihood < _MIN_LIKELIHOOD or repeats:
        return (
            "the log follows the ball at no lag: it is of another time or another mouse, or too short; record both at "
            "once, for half a minute"
        )
    missing = [k for k in (0, 2) if not match.known[k]]
    if missing:
        return (
            f"too little motion about {' and '.join('XYZ'[k] for k in missing)} to estimate the scale: "
            f"{' and '.join(_ADVICE[k] for k in missing)}, and record again"
        )
    for axis, counts in zip("xy", match.travel, strict=True):
        if counts < _MIN_COUNTS:
            return (
                f"the trackball's {axis} hardly moved ({counts:.0f} counts) while the ball did: one of its sensors is "
                "dirty or broken, or it does not touch the ball"
            )
    if r < _MIN_FAIR_R:
        return (
            f"the log follows the ball badly (r = {r:.2f} over 0.1 s), so it gives no scale: clean the "
            "trackball, and see that the camera tracks the ball"
        )
    return None


def _time_notes(match: Match) -> list[str]:
    notes = []
    if abs(match.lag) > _MAX_LAG_OF_A_MOUSE_S:
        notes.append(
            f"the clock of the log is {abs(match.lag):.3f} s {'ahead of' if match.lag > 0 else 'behind'} that of the "
            "frames; this does no harm"
        )
    if match.peak.rival > _RIVAL_RATIO * match.peak.likelihood:
        notes.append("the motion repeats itself, so another lag explains the log nearly as well; move less evenly")
    if match.outliers > _MAX_OUTLIERS * match.intervals:
        notes.append(
            f"{match.outliers} of {match.intervals} intervals of 0.1 s do not fit: reports are missing, or the "
            "trackball slips"
        )
    return notes


# ---- axes ----


@dataclass(frozen=True, slots=True)
class TrackballAxes:
    """Scales and directions of the trackball's axes. Settings can express swap and signs, but not `turn`."""

    swapped: bool
    scale: tuple[float, float]  # counts/rad of x and y, with their signs
    sigma: tuple[float, float]  # counts/rad
    turn: float  # rad about Y, right-handed, beyond swap and signs
    turn_sigma: float  # rad
    contact: tuple[float, float, float] | None  # unit vector in obj to the point of contact; None if unknown


def axes_of(match: Match) -> TrackballAxes:
    """Split the matrix of a match into swap, scales, turn and point of contact."""
    A, S = match.matrix, match.sigma
    swapped = bool(A[0, 0] ** 2 + A[1, 2] ** 2 > A[0, 2] ** 2 + A[1, 0] ** 2)
    x, y = (0, 2) if swapped else (2, 0)
    on, off = np.array([A[0, x], A[1, y]]), np.array([A[0, y], A[1, x]])
    sigma = float(S[0, x]), float(S[1, y])
    size = np.hypot(on, off) * np.sign(on)
    sine = off[0] / size[0] - off[1] / size[1]
    turn = float(np.arctan2(-sine if swapped else sine, np.sum(on / size)))
    turn_sigma = float(0.5 * np.hypot(*(np.array([S[0, y], S[1, x]]) / size)))
    contact = None
    if bool(np.all(match.known)):
        null = np.cross(A[0], A[1])  # rotation about the point of contact moves nothing
        null *= -np.sign(null[1]) / np.linalg.norm(null)
        contact = (float(null[0]), float(null[1]), float(null[2]))
    return TrackballAxes(swapped, (float(on[0]), float(on[1])), sigma, turn, turn_sigma, contact)


def _axis_notes(match: Match) -> list[str]:
    axes = axes_of(match)
    notes = []
    if axes.swapped:
        notes.append("x of the trackball follows the ball that rolls towards the camera and away: it is turned by 90°")
    if _player(axes)[1]:
        notes.append("the axes are those of a mirror image, which no player's hand makes; y is reversed")
    if abs(axes.turn) > max(_MIN_TURN, 3.0 * axes.turn_sigma):
        notes.append(
            f"the axes are turned by {np.degrees(axes.turn):+.1f} ± {np.degrees(axes.turn_sigma):.1f}° about Y, which "
            "no setting expresses: the pointer's direction differs by that angle"
        )
    if axes.contact is not None:
        tilt = float(np.arccos(np.clip(-axes.contact[1], -1.0, 1.0)))
        if tilt > _MIN_TILT:
            notes.append(
                f"it touches the ball {np.degrees(tilt):.0f}° from the lowest point (towards X {axes.contact[0]:+.2f}, "
                f"Z {axes.contact[2]:+.2f} of obj): a spin of the ball moved it and will not move the pointer"
            )
    return notes


def settings_of(match: Match, radius: float | None, before: MotionSettings) -> MotionSettings:
    """Return settings that move x and y of the pointer as the trackball did; the third axis stays as in `before`.

    `radius` is the ball's in m. If it is None, as for a rig of free scale, the scale is per radian. Both axes get one
    scale if they differ by no more than twice the standard deviation of their difference.
    """
    axes = axes_of(match)
    x, y = abs(axes.scale[0]), abs(axes.scale[1])
    if abs(x - y) <= 2.0 * float(np.hypot(*axes.sigma)):
        x = y = float(np.average([x, y], weights=np.array(axes.sigma) ** -2.0))
    unit = 1.0 if radius is None else 1000.0 * radius  # mm/rad
    scale = _rounded(float(np.sqrt(x * y)) / unit)
    player, mirrored = _player(axes)
    return replace(
        before,
        player=player,
        counts_per_mm=before.counts_per_mm if radius is None else scale,
        counts_per_radian=scale if radius is None else None,
        scale_x=1.0 if x == y else _rounded(x / (unit * scale)),
        scale_y=1.0 if x == y else _rounded(y / (unit * scale)),
        scale_z=_rounded(before.scale_z * before.scale(radius) / (unit * scale)),
        invert_x=False,
        invert_y=mirrored,
    )


def _player(axes: TrackballAxes) -> tuple[Player, bool]:
    """Return the player's place for which x of the trackball is right, and True if its y is reversed there."""
    seats: tuple[Player, Player] = ("left", "right") if axes.swapped else ("far-side", "camera-side")
    player = seats[axes.scale[0] < 0.0]
    y = MotionSettings(player=player).directions()[1]
    return player, bool(axes.scale[1] * y[2 if axes.swapped else 0] < 0.0)


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
