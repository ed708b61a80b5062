"""Choose places for discs, and assess the places of discs on a ball. Directions in `ball`, angles in rad.

An irregular layout that is spread over the whole ball is good. A regular one looks the same from several sides, so one
picture does not give the attitude. A layout with bare patches leaves too few discs in view.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.ball.associate import identify
from spheremouse.geometry.rotation import Array, exp, fibonacci_sphere, hat, log, tangent_basis
from spheremouse.simulate.ball.scene import spread_directions

MIN_DISCS, MAX_DISCS = 4, 120
ENOUGH_IN_VIEW = 4  # three give an attitude, the fourth confirms it
RADIUS, DISC_RADIUS = 0.6, 0.02  # m, defaults
TRIAL_SIGMA = np.radians(0.1)  # of a direction
TRIAL_HIDDEN = 0.2  # probability that a disc in view is hidden
_TRIALS = 300
_CANDIDATES = 20
_CAMERA_DIRECTIONS = 5000
_TOLERANCE = 0.02  # rad, of a recognised attitude


@dataclass(frozen=True, slots=True)
class Assessment:
    """Properties of a layout."""

    in_view: int  # smallest number of discs in view, over all directions to the camera
    distance: float  # rad, between the two nearest discs
    nearest: tuple[int, int]  # indices of these two
    recognised: float  # fraction of random attitudes that one picture gives
    mistaken: float  # fraction for which it gives another attitude


def choose_directions(n: int, view_angle: float, min_distance: float, seed: int) -> Array:
    """Return irregular directions (n, 3), well spread; of 20 candidates those with most discs in view.

    The same arguments give the same directions. Raises ValueError if so many discs do not fit.
    """
    rng = np.random.default_rng(seed)
    candidates = [spread_directions(n, min_distance, rng) for _ in range(_CANDIDATES)]
    return _in_order(max(candidates, key=lambda d: (min_in_view(d, view_angle), _nearest(d)[0])))


def assess(directions: Array, view_angle: float) -> Assessment:
    """Assess a layout (n, 3) for a camera that sees discs within `view_angle` of the direction to it."""
    distance, nearest = _nearest(directions)
    return Assessment(min_in_view(directions, view_angle), distance, nearest, *recognition(directions, view_angle))


def min_in_view(directions: Array, view_angle: float) -> int:
    """Return the smallest number of discs in view, over 5,000 directions to the camera."""
    seen = fibonacci_sphere(_CAMERA_DIRECTIONS) @ directions.T > np.cos(view_angle)
    return int(seen.sum(axis=1).min())


def recognition(directions: Array, view_angle: float) -> tuple[float, float]:
    """Return the fractions of random attitudes that `identify` recognises, and that it mistakes for others."""
    rng, camera, cosine = np.random.default_rng(0), np.array([0.0, 0.0, 1.0]), np.cos(view_angle)
    recognised = mistaken = 0
    for _ in range(_TRIALS):
        R = _random_rotation(rng)
        seen = directions @ R.T
        seen = seen[(seen[:, 2] > cosine) & (rng.random(len(seen)) >= TRIAL_HIDDEN)]
        seen = _unit(seen + TRIAL_SIGMA * rng.standard_normal(seen.shape))
        horizon = float(np.cos(view_angle + 0.05))  # a disc near the limb may be in view or not
        found = identify(seen, directions, sigma=float(TRIAL_SIGMA), view_axis=camera, horizon=horizon)
        if found is not None:
            right = bool(np.linalg.norm(log(found.rotation @ R.T)) < _TOLERANCE)
            recognised, mistaken = recognised + right, mistaken + (not right)
    return recognised / _TRIALS, mistaken / _TRIALS


def misplaced(directions: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Return directions with errors of `sigma` rad in both directions along the surface."""
    offset = sigma * rng.standard_normal((len(directions), 2))
    return _unit(directions + np.einsum("nij,nj->ni", tangent_basis(directions), offset))


def _in_order(directions: Array) -> Array:
    """Turn and sort the layout for a person. Disc 1 is at the pole z, its nearest neighbour towards x.

    The others follow from the pole down.
    """
    _, (pole, neighbour) = _nearest(directions)
    z = directions[pole]
    x = _unit(directions[neighbour] - (directions[neighbour] @ z) * z)
    turned: Array = directions @ np.stack([x, hat(z) @ x, z], axis=1)
    return turned[np.argsort(-turned[:, 2], kind="stable")]


def _nearest(directions: Array) -> tuple[float, tuple[int, int]]:
    """Return the angle between the two nearest discs, and their indices."""
    cosine = directions @ directions.T - 3.0 * np.eye(len(directions))
    i, j = divmod(int(np.argmax(cosine)), len(directions))
    return float(np.arccos(np.clip(cosine[i, j], -1.0, 1.0))), (i, j)


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _random_rotation(rng: np.random.Generator) -> Array:
    """Return a rotation (3, 3), uniform over all: a random axis for the pole and a random turn about it."""
    columns, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return columns * np.linalg.det(columns) @ exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
