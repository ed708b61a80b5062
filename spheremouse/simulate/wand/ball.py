"""A hand-held ball: its discs are true spherical caps, in any light.

The code is independent of the particle filter's projection: it casts rays, and the filter projects points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation, sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.cast import AT_ORIGIN, PARTS, Surfaces, Viewpoint
from spheremouse.simulate.layers import Layer, window
from spheremouse.simulate.light import reflectance
from spheremouse.simulate.shapes import Colour, Sphere
from spheremouse.simulate.wand.path import R_CAM_WORLD
from spheremouse.wand.ball import WandBall

_MARGIN_PX = 2  # px around the ball
_UP = R_CAM_WORLD @ (0.0, -1.0, 0.0)  # cam

# Paints as on a screen, blue, green, red: paper or foam as such balls are made of
_PAINTS = {
    "white": (225.0, 228.0, 230.0),
    "black": (26.0, 26.0, 26.0),
    "red": (32.0, 28.0, 196.0),
    "blue": (178.0, 64.0, 28.0),
    "green": (60.0, 150.0, 40.0),
    "dark": (30.0, 28.0, 28.0),
    "light": (235.0, 245.0, 255.0),
}
_LIT, _OWN_LIGHT = ("light",), 1.1  # discs that shine by themselves, as bright as the sensor takes


@dataclass(frozen=True, slots=True)
class WandLight:
    """Lights on the ball; powers are linear, 1 is the white of the picture."""

    towards: Array  # (k, 3) unit vectors to lamps or sun, cam
    power: Array  # (k, 3) blue, green, red
    above: Array  # (3,) from the sky or the ceiling
    below: Array  # (3,) from the floor
    gloss: float  # of the ball: brightness of the highlights
    polish: float  # the higher the smaller the highlights are


def paint_of(colour: str) -> Colour:
    """Return the reflectance of a disc or a body by its colour's name; grey if unknown."""
    return reflectance(_PAINTS.get(colour, (128.0, 128.0, 128.0)))


def disc_paints(ball: WandBall) -> Array:
    """Return the `paints`, (n + 1, 3), of the ball's body, then of its discs."""
    return np.array([paint_of(ball.body), *(paint_of(d.colour) for d in ball.discs)])


def paint_ball(
    ball: WandBall, paints: Array, moments: Sequence[tuple[Array, Array]], camera: InteriorOrientation, light: WandLight
) -> Layer | None:
    """The ball, averaged over poses (centre (3,) m, R_cam_ball (3, 3)) in the exposure; None if it is out of view."""
    moments = [(c, R) for c, R in moments if c[2] > 2.0 * ball.radius]
    rims = np.array([sphere_outline(c, ball.radius, camera, 64) for c, _ in moments]).reshape(-1, 2)
    place = window(rims[np.isfinite(rims).all(axis=1)], _MARGIN_PX, camera)
    if place.empty:
        return None
    paint = []
    for centre, R in moments:
        caps = tuple((R @ disc.direction, disc.angle) for disc in ball.discs)
        view = Viewpoint([Sphere(centre, ball.radius, paint_of(ball.body), caps)], AT_ORIGIN)
        paint.append(view.paint(place, camera, partial(_shade, ball, paints, centre, light)))
    return Layer(place, np.asarray(np.mean(paint, axis=0), dtype=np.float32))


def _shade(ball: WandBall, paints: Array, centre: Array, light: WandLight, surfaces: Surfaces, points: Array) -> Array:
    """Return the light, (n, 4) blue, green, red and cover, of surfaces, (n,), at points, (n, 3) m, cam."""
    out = np.zeros((len(surfaces), 4))
    hit = np.flatnonzero(surfaces)
    label, n = surfaces[hit] % PARTS, (points[hit] - centre) / ball.radius
    upward = 0.5 + 0.5 * (n @ _UP)[:, None]
    facing = np.maximum(n @ light.towards.T, 0.0)
    half = light.towards - centre / np.linalg.norm(centre)  # between lamp and eye (Blinn 1977)
    along = n @ (half / np.linalg.norm(half, axis=1, keepdims=True)).T
    shine = np.where((facing > 0.0) & (along > 0.8), np.abs(along), 0.0) ** light.polish  # beside it hardly any
    lit = np.array([0.0, *(_OWN_LIGHT * (d.colour in _LIT) for d in ball.discs)])[label, None]
    lamps = facing @ light.power + upward * light.above + (1.0 - upward) * light.below
    out[hit, :3] = paints[label] * (lamps + lit) + light.gloss * shine @ light.power
    out[hit, 3] = 1.0
    return out
