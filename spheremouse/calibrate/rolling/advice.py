"""What would make a rolled calibration better, from its own covariance and from what the ball has shown."""

import numpy as np

from spheremouse.calibrate.rolling.problem import Rolled, Rolling
from spheremouse.geometry.rotation import Array, log

GOOD_RATIO, GOOD_DIRECTION = 1e-3, float(np.deg2rad(0.02))  # beyond these tracking suffers
_ONE_AXIS = 0.05  # share of the turning about any other axis, below which the ball was rolled about one alone
_UNSEEN = 0.1  # share of the ball's surface


def advise(rolled: Rolled) -> list[str]:
    """Sentences, the most useful first; none where nothing is amiss."""
    said: list[str] = []
    ratio, direction = sigmas(rolled)
    worst = max(ratio / GOOD_RATIO, direction / GOOD_DIRECTION)
    shares = turned(rolled.rolling)
    if shares[1] < _ONE_AXIS:
        said.append("the ball was rolled about one axis only: roll it across that, too")
    if worst > 1.0:
        span = float(rolled.rolling.stamp[-1] - rolled.rolling.stamp[0])
        per_frame = len(rolled.sightings) / len(rolled.rolling.stamp)
        if per_frame < 4.0:
            said.append(f"only {per_frame:.1f} discs are measured at a time: more discs on the ball would help most")
        said.append(
            f"the result is {worst:.1f} times less certain than good tracking needs: "
            f"roll for {span * worst**2:.0f} s in place of {span:.0f}"
        )
    missed = unseen(rolled.rolling)
    if missed > _UNSEEN:
        said.append(
            f"{100.0 * missed:.0f} % of the ball never faced the camera: roll on until every side was in view, "
            "and the map of its discs is whole"
        )
    return said


def sigmas(rolled: Rolled) -> tuple[float, float]:
    """Standard deviations of the ratio, as a part of it, and of the direction, rad along its worse axis."""
    worst = float(np.linalg.eigvalsh(rolled.covariance[:3, :3])[-1])
    return float(np.sqrt(rolled.covariance[3, 3])) / rolled.rolling.ratio, float(np.sqrt(max(worst, 0.0)))


def turned(rolling: Rolling) -> Array:
    """Shares of the turning about each of three axes at right angles, (3,), largest first: (1, 0, 0) one axis alone."""
    turn = log(rolling.attitude[1:] @ rolling.attitude[:-1].transpose(0, 2, 1))
    near = np.linalg.norm(turn, axis=1) < 0.5  # rad: more is a gap
    value = np.asarray(np.linalg.eigvalsh(turn[near].T @ turn[near])[::-1], dtype=float)
    return value / max(float(value.sum()), 1e-12)


def unseen(rolling: Rolling) -> float:
    """Share of the ball's surface that never faced the camera, limb left out."""
    k = np.arange(400) + 0.5
    z = 1.0 - 2.0 * k / 400
    angle = np.pi * (1.0 + 5.0**0.5) * k
    places = np.stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z], axis=1)
    towards = np.einsum("fji,j->fi", rolling.attitude, -rolling.direction)
    least = np.cos(0.85 * np.arccos(1.0 / rolling.ratio))
    return float(np.mean(np.max(towards @ places.T, axis=0) < least))
