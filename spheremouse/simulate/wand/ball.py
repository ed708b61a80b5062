"""Ray casting of a hand-held ball. Its discs are true spherical caps, anti-aliased, in any light.

A pixel gets one ray on a plain part of ball or disc, and many rays on an edge. The result is averaged over the
exposure. The code is independent of the particle filter's projection: it casts rays, and the filter projects points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, ellipse_to_pixel, project_sphere, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.layers import Layer, window
from spheremouse.simulate.light import reflectance
from spheremouse.simulate.shapes import Colour, Sphere, pixel_parts
from spheremouse.simulate.wand.path import R_CAM_WORLD
from spheremouse.wand.ball import WandBall

# rays across a pixel with an edge, in each direction; fewer where many moments are averaged
_RAYS_ACROSS_EDGE_PIXEL = 6
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
    ends = np.array([_extent(c, ball.radius, camera) for c, _ in moments]).reshape(-1, 2)
    place = window(ends[np.isfinite(ends).all(axis=1)], _MARGIN_PX, camera)
    if place.empty:
        return None
    uv = place.pixels()
    ray = _rays(uv, camera)
    # rays through the corners of all pixels find those with an edge
    corner = _rays(place._replace(right=place.right + 1, bottom=place.bottom + 1).pixels() - 0.5, camera)
    out = np.zeros((*uv.shape[:2], 4), dtype=np.float32)
    parts = pixel_parts(max(2, int(np.ceil(_RAYS_ACROSS_EDGE_PIXEL / np.sqrt(len(moments))))))
    for pose in moments:
        at = _surface(ball, pose, corner)[0].reshape(np.add(uv.shape[:2], 1))
        label, normal = _surface(ball, pose, ray)
        around = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]], axis=-1).reshape(-1, 4)
        edge = np.any(around != label[:, None], axis=1)
        picture = _shade(ball, paints, pose[0], light, np.where(edge, -1, label), normal)
        fine = _surface(ball, pose, _rays(uv.reshape(-1, 1, 2)[edge] + parts, camera))
        picture[edge] = _shade(ball, paints, pose[0], light, *fine).reshape(-1, len(parts), 4).mean(axis=1)
        out += picture.reshape(out.shape) / len(moments)
    return Layer(place, out)


def _extent(centre: Array, radius: float, camera: InteriorOrientation) -> Array:
    """Return two corners of the picture of a sphere with its centre at (3,) m in cam, (2, 2) px."""
    middle, outline = project_sphere(centre, radius)
    uv, shape = ellipse_to_pixel(middle[None], outline[None], camera)
    half = np.sqrt(np.diag(shape[0]))
    return np.array([uv[0] - half, uv[0] + half])


def _rays(uv: Array, camera: InteriorOrientation) -> Array:
    """Return the rays, (n, 3) cam, of pixels, (..., 2); nan where the lens has none."""
    xy, _ = unproject(uv, camera)
    return np.column_stack([xy, np.ones(len(xy))])


def _surface(ball: WandBall, pose: tuple[Array, Array], ray: Array) -> tuple[NDArray[np.intp], Array]:
    """Return what rays, (n, 3) cam, hit (-1 nothing, 0 the body, k + 1 disc k), and its unit normals, (n, 3) cam."""
    centre, rotation = pose
    depth = Sphere(centre, ball.radius, paint_of(ball.body)).hit(np.zeros(3), ray)
    hit = np.isfinite(depth)  # False for a pixel without a ray
    normal = (np.where(hit, depth, 0.0)[:, None] * ray - centre) / ball.radius
    label = np.where(hit, 0, -1)
    for k, disc in reversed(list(enumerate(ball.discs))):  # the first of two discs covers the other
        label[hit & (normal @ (rotation @ disc.direction) > np.cos(disc.angle))] = k + 1
    return label, normal


def _shade(
    ball: WandBall, paints: Array, centre: Array, light: WandLight, label: NDArray[np.intp], normal: Array
) -> Array:
    """Return the light, (n, 4) blue, green, red and cover, of the surfaces of `_surface`."""
    out = np.zeros((len(label), 4))
    hit = np.flatnonzero(label >= 0)
    label, n = label[hit], normal[hit]
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
