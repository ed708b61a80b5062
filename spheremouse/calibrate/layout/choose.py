"""Choose places for discs on a ball, and give each in lengths of a tape measure. Directions in `ball`, angles in rad.

A good layout is irregular and spread over the whole ball. A regular one looks the same from several sides, so one
picture does not give the attitude. A layout with bare patches leaves too few discs in view.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array, fibonacci_sphere, hat
from spheremouse.simulate.ball.scene import spread_directions

_CANDIDATE_LAYOUTS = 20
_CAMERA_DIRECTIONS = 5000


@dataclass(frozen=True, slots=True)
class Place:
    """Place of one disc, in mm along the surface.

    The tape runs from a pole P over a band of masking tape round the equator with a scale in mm.
    """

    number: int  # from 1, in the order of work
    band: int | None  # reading of the band under the tape; None at the pole
    from_pole: int
    below_band: int  # negative towards the pole
    checks: tuple[tuple[int, int], ...]  # number of a disc on the ball, and distance to it


def choose_directions(n: int, view_angle: float, min_distance: float, seed: int) -> Array:
    """Return irregular directions (n, 3), at least `min_distance` apart.

    Of 20 candidates it takes the one with most discs within `view_angle` of a camera's direction, at the barest side.
    Disc 1 is at the pole z, its nearest neighbour towards x; the others follow from the pole down. The same arguments
    give the same directions. Raises ValueError if so many discs do not fit.
    """
    rng = np.random.default_rng(seed)
    candidates = [spread_directions(n, min_distance, rng) for _ in range(_CANDIDATE_LAYOUTS)]
    chosen = max(candidates, key=lambda d: (min_in_view(d, view_angle), nearest(d)[0]))
    _, (pole, neighbour) = nearest(chosen)
    z = chosen[pole]
    x = chosen[neighbour] - (chosen[neighbour] @ z) * z
    x /= np.linalg.norm(x)
    turned: Array = chosen @ np.stack([x, hat(z) @ x, z], axis=1)
    return turned[np.argsort(-turned[:, 2], kind="stable")]


def min_in_view(directions: Array, view_angle: float) -> int:
    """Return the smallest number of discs within `view_angle` rad of the direction to a camera, over 5,000 cameras.

    The discs have unit `directions` (n, 3).
    """
    seen = fibonacci_sphere(_CAMERA_DIRECTIONS) @ directions.T > np.cos(view_angle)
    return int(seen.sum(axis=1).min())


def nearest(directions: Array) -> tuple[float, tuple[int, int]]:
    """Return the angle, rad, between the two nearest of unit `directions` (n, 3), and their indices."""
    cosine = directions @ directions.T - 3.0 * np.eye(len(directions))
    i, j = divmod(int(np.argmax(cosine)), len(directions))
    return float(np.arccos(np.clip(cosine[i, j], -1.0, 1.0))), (i, j)


def tape_step(radius: float) -> int:
    """Return the step of the tape's readings in mm: 5 on a large ball, 1 on one that a hand can hold."""
    return 5 if radius >= 0.3 else 1


def on_the_tape(directions: Array, radius: float) -> Array:
    """Round directions (n, 3) to whole steps of the tape, from the pole and along the band."""
    step = 1e-3 * tape_step(radius) / radius
    polar = np.rint(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / step) * step
    azimuth = np.rint(np.arctan2(directions[:, 1], directions[:, 0]) / step) * step
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def places(directions: Array, radius: float) -> list[Place]:
    """Return the lengths to measure for discs at `directions` (n, 3) on a ball of `radius` m.

    The two nearest of the discs before each one give its checks.
    """
    step, mm = tape_step(radius), 1e3 * radius
    angle = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))

    def taped(length: float) -> int:
        return int(round(length / step) * step)

    circumference = max(taped(2 * np.pi * mm), 1)
    found = []
    for k, (x, y, z) in enumerate(directions):
        polar = float(np.arccos(np.clip(z, -1.0, 1.0)))
        at_pole = np.hypot(x, y) * mm < 0.5 * step
        reading = taped(float(np.arctan2(y, x)) % (2.0 * np.pi) * mm) % circumference
        before = np.argsort(angle[k, :k], kind="stable")[:2]
        checks = tuple((int(j) + 1, taped(float(angle[k, j]) * mm)) for j in before)
        below_band = taped((polar - 0.5 * np.pi) * mm)
        found.append(Place(k + 1, None if at_pole else reading, taped(polar * mm), below_band, checks))
    return found
