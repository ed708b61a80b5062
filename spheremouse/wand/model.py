"""Points on a ball with their expected colours, which the likelihood compares with a picture."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array, tangent_basis
from spheremouse.native import kernels
from spheremouse.wand.ball import WandBall

_RIM_POINTS = 12
_OUTER_POINTS = 6  # just outside a rim
_OUTER_DISTANCE = 0.11  # rad from the rim: half the gap of two discs, and 3 px of a ball 50 px across
_BARE_CANDIDATES = 80  # directions


@dataclass(frozen=True, slots=True)
class Points:
    """Points on a ball, in `ball`."""

    # (p, 10): direction, unit; tangent along the rim, unit; rad from the rim towards the disc's centre, negative
    # outside the disc; rad to the far rim; 1 / tan of the disc's angular radius; sr of each point of the disc, at
    # its first point, the centre, and 0 at the others
    table: Array
    colour: NDArray[np.int64]  # (p,) index of the colour; -1 of a bare point


@dataclass(frozen=True, slots=True)
class Model:
    """Ball, points and camera."""

    points: Points
    radius: float  # m
    lens: Array  # (9,) fx, fy, cx, cy, k1, k2, p1, p2, k3
    kernel: kernels.BallModel = field(init=False)  # the same for native functions

    def __post_init__(self) -> None:
        kernel = kernels.BallModel(self.points.table, self.points.colour, self.radius, self.lens)
        object.__setattr__(self, "kernel", kernel)


def ball_points(ball: WandBall, names: tuple[str, ...]) -> Points:
    """Return the points of a ball. `names` are the colours of the fields."""
    table, colour = [], []

    def add(u: Array, along: Array, inside: float, angle: float, c: int, solid_angle: float = 0.0) -> None:
        table.append([*u, *along, inside, 2.0 * angle - inside, 1.0 / np.tan(angle), solid_angle])
        colour.append(c)

    for disc in ball.discs:
        c = names.index(disc.colour)
        basis = tangent_basis(disc.direction)
        of_each = np.pi * disc.angle**2 / (5 + _RIM_POINTS)
        add(disc.direction, basis[:, 0], disc.angle, disc.angle, c, of_each)  # the centre comes first
        rings = (
            (4, disc.points_angle, disc.angle - disc.points_angle),
            (_RIM_POINTS, disc.angle, 0.0),
            (_OUTER_POINTS, disc.angle + _OUTER_DISTANCE, -_OUTER_DISTANCE),
        )
        for n, away, inside in rings:
            for phi in np.arange(n) * (2.0 * np.pi / n):
                out = basis @ np.array([np.cos(phi), np.sin(phi)])
                along = basis @ np.array([-np.sin(phi), np.cos(phi)])
                u = np.cos(away) * disc.direction + np.sin(away) * out
                if inside >= 0.0 or not _within(u, ball, _OUTER_DISTANCE / 2, disc.colour):
                    add(u, along, inside, disc.angle, c)
    for u in _spiral(_BARE_CANDIDATES):
        if not _within(u, ball, 1.5 * _OUTER_DISTANCE, colour=None):
            of_each = 0.0 if -1 in colour else 4.0 * np.pi / _BARE_CANDIDATES
            add(u, tangent_basis(u)[:, 0], -1.0, 1.0, -1, of_each)
    return Points(np.array(table), np.array(colour, dtype=np.int64))


def ball_model(ball: WandBall, camera: InteriorOrientation, names: tuple[str, ...] | None = None) -> Model:
    """Return a ball before a camera. `names` are the colours of the fields, by default those of the ball."""
    return Model(
        ball_points(ball, names or ball.colours), ball.radius, np.concatenate([camera.intrinsic, camera.distortion])
    )


def _spiral(n: int) -> Array:
    """Return n directions, (n, 3), evenly spread over the sphere (golden spiral)."""
    z = 1.0 - (np.arange(n) + 0.5) * 2.0 / n
    azimuth = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)


def _within(u: Array, ball: WandBall, margin: float, colour: str | None) -> bool:
    """Return true if a direction is inside a disc of a colour, or of any, or within `margin` rad of it."""
    return any(
        np.arccos(np.clip(u @ d.direction, -1.0, 1.0)) < d.angle + margin
        for d in ball.discs
        if colour is None or d.colour == colour
    )
