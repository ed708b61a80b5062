"""Ray casting of a hand-held ball. Its discs are true spherical caps, anti-aliased, in any light.

A pixel gets one ray on a plain part of ball or disc, and many rays on an edge. The result is averaged over the
exposure. The code is independent of the particle filter's projection: it casts rays, and the filter projects points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, ellipse_to_pixel, project_sphere, unproject
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.light import reflectance
from spheremouse.simulate.shapes import pixel_parts
from spheremouse.wand.ball import WandBall

FINE = 6  # rays across a pixel with an edge, in each direction; fewer where many moments are averaged

# Paints as on a screen, blue, green, red: paper or foam as such balls are made of
PAINTS = {
    "white": (225.0, 228.0, 230.0),
    "black": (26.0, 26.0, 26.0),
    "red": (32.0, 28.0, 196.0),
    "blue": (178.0, 64.0, 28.0),
    "green": (60.0, 150.0, 40.0),
    "dark": (30.0, 28.0, 28.0),
    "light": (235.0, 245.0, 255.0),
}
LIT = ("light",)  # discs that shine by themselves
_LIT = 1.1  # of their own light: as bright as the sensor takes


class Layer(NamedTuple):
    """Something painted into a part of the picture."""

    place: tuple[int, int]  # px, column and row of its first pixel
    paint: NDArray[np.float32]  # (h, w, 4) light in blue, green, red, times its cover; cover 0..1


@dataclass(frozen=True, slots=True)
class WandLight:
    """Lights on the ball; powers are linear, 1 is the white of the picture."""

    towards: Array  # (k, 3) unit vectors to lamps or sun, cam
    power: Array  # (k, 3) blue, green, red
    above: Array  # (3,) from the sky or the ceiling
    below: Array  # (3,) from the floor
    up: Array  # (3,) unit vector, cam
    gloss: float  # of the ball: brightness of the highlights
    polish: float  # the higher the smaller the highlights are


def paint_of(colour: str) -> Array:
    """Return the reflectance, (3,) blue, green, red, of a disc or a body by its colour's name; grey if unknown."""
    return np.array(reflectance(PAINTS.get(colour, (128.0, 128.0, 128.0))))


def disc_paints(ball: WandBall) -> Array:
    """(n + 1, 3): of the ball's body, then of its discs."""
    return np.array([paint_of(ball.body), *(paint_of(d.colour) for d in ball.discs)])


def window(centre: Array, radius: float, camera: InteriorOrientation, margin: float = 2.0) -> tuple[int, ...]:
    """Return first and last+1 column, first and last+1 row that may show a sphere, cut to the picture.

    The sphere has its centre at (3,) m in cam and `radius` m. `margin` px are added on each side.
    """
    middle, outline = project_sphere(centre, radius)
    uv, shape = ellipse_to_pixel(middle[None], outline[None], camera)
    half = np.sqrt(np.diag(shape[0])) + margin
    if not np.all(np.isfinite(half)):
        return 0, 0, 0, 0
    low = np.clip(np.floor(uv[0] - half), 0, (camera.width, camera.height)).astype(int)
    high = np.clip(np.ceil(uv[0] + half) + 1, 0, (camera.width, camera.height)).astype(int)
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])


def paint_ball(
    ball: WandBall, paints: Array, moments: Sequence[tuple[Array, Array]], camera: InteriorOrientation, light: WandLight
) -> Layer | None:
    """The ball, averaged over poses (centre (3,) m, R_cam_ball (3, 3)) in the exposure; None where it is not in view.

    `paints` as of `disc_paints`.
    """
    windows = np.array([window(c, ball.radius, camera) for c, _ in moments if c[2] > 2.0 * ball.radius])
    if len(windows) == 0:
        return None
    left, top = windows[:, 0].min(), windows[:, 2].min()
    out = np.zeros((max(windows[:, 3].max() - top, 0), max(windows[:, 1].max() - left, 0), 4), dtype=np.float32)
    if out.size == 0:
        return None
    fine = max(2, int(np.ceil(FINE / np.sqrt(len(moments)))))
    for centre, rotation in moments:
        if centre[2] > 2.0 * ball.radius:
            caster = _RayCaster(ball, paints, np.asarray(centre, dtype=float), rotation, camera, light)
            out += _picture(caster, int(left), int(top), out.shape, fine) / len(moments)
    return Layer((int(left), int(top)), out)


@dataclass(frozen=True, slots=True)
class _RayCaster:
    """A ball at one pose before a camera, in a light."""

    ball: WandBall
    paints: Array  # (d + 1, 3) of `disc_paints`
    centre: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    camera: InteriorOrientation
    light: WandLight

    def surface(self, uv: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the surfaces at pixels (n, 2), and their unit normals, (n, 3) cam.

        A surface is -1 for nothing, 0 for the body and k + 1 for the k-th disc.
        """
        xy, _ = unproject(uv, self.camera)
        ray, r2 = np.column_stack([xy, np.ones(len(xy))]), self.ball.radius**2
        a, b = np.sum(ray * ray, axis=1), ray @ self.centre
        root = b * b - a * (self.centre @ self.centre - r2)
        hit = (root >= 0.0) & (b > 0.0)  # False for a pixel without a ray
        normal = (((b - np.sqrt(np.where(hit, root, 0.0))) / a)[:, None] * ray - self.centre) / self.ball.radius
        label = np.where(hit, 0, -1)
        for k, disc in reversed(list(enumerate(self.ball.discs))):  # the first of two discs covers the other
            label[hit & (normal @ (self.rotation @ disc.direction) > np.cos(disc.angle))] = k + 1
        return label, normal

    def shade(self, label: NDArray[np.intp], normal: Array) -> Array:
        """Return the light, (n, 4) blue, green, red and cover, of the surfaces of `surface`."""
        light = self.light
        out = np.zeros((len(label), 4))
        hit = np.flatnonzero(label >= 0)
        label, n = label[hit], normal[hit]
        upward = 0.5 + 0.5 * (n @ light.up)[:, None]
        facing = np.maximum(n @ light.towards.T, 0.0)
        half = light.towards - self.centre / np.linalg.norm(self.centre)  # between lamp and eye (Blinn 1977)
        along = n @ (half / np.linalg.norm(half, axis=1, keepdims=True)).T
        shine = np.where((facing > 0.0) & (along > 0.8), np.abs(along), 0.0) ** light.polish  # beside it hardly any
        lit = np.array([0.0, *(_LIT * (d.colour in LIT) for d in self.ball.discs)])[label, None]
        lamps = facing @ light.power + upward * light.above + (1.0 - upward) * light.below
        out[hit, :3] = self.paints[label] * (lamps + lit) + light.gloss * shine @ light.power
        out[hit, 3] = 1.0
        return out


def _picture(caster: _RayCaster, left: int, top: int, shape: tuple[int, ...], fine: int) -> Array:
    """Return a picture (h, w, 4) of `shape`, with the first pixel at (left, top).

    A pixel gets one ray, or fine² rays if an edge runs through it.
    """
    h, w = shape[:2]
    v, u = np.mgrid[top : top + h + 1, left : left + w + 1]
    corner = caster.surface(np.column_stack([u.ravel(), v.ravel()]) - 0.5)[0].reshape(h + 1, w + 1)
    uv = np.column_stack([u[:h, :w].ravel(), v[:h, :w].ravel()]).astype(float)
    label, normal = caster.surface(uv)
    around = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]], axis=-1).reshape(-1, 4)
    edge = np.any(around != label[:, None], axis=1)
    out = caster.shade(np.where(edge, -1, label), normal)
    rays = caster.shade(*caster.surface((uv[edge, None] + pixel_parts(fine)).reshape(-1, 2)))
    out[edge] = rays.reshape(-1, fine * fine, 4).mean(axis=1)
    return out.reshape(h, w, 4)
